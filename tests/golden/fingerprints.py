"""Fingerprints of short runs: what `fingerprints.json` holds, and how to write it anew.

    python tests/golden/fingerprints.py        writes it, and prints what changed and by how much
    python tests/golden/fingerprints.py NAME…  writes only these scenes

A case is a scene with some of its keys overridden, and a number of steps. Every frame of the run goes into hashes, one
for each part of it, so that a failure names the part that changed: state, energy, ledger, steps, contacts, torques.
Values are hashed as plain 64-bit numbers in a fixed order, so that classes, fields and modules of carom may be renamed.
The energy scale is left out: it was a dot product of BLAS, which rounds differently on other processors.

Beside the hashes stand the largest errors of energy and momentum, the impacts and the steps, so that an intended change
shows its size when it is written. The errors depend on the energy scale, so they are rounded and not compared.

The file holds each combination of methods that a scene admitted when it was written. The test runs these cases, so a
combination that is refused later is a failure.
"""

from __future__ import annotations

import itertools
import json
import sys
import time
import tomllib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from carom.errors import SceneError
from carom.physics.schedule import every
from carom.physics.space import Space
from carom.scene.data.body_sources import DataFiles
from carom.scene.load import Scene, scene_from_dict
from carom.scene.scene_file import bundled_scenes, extreme_scenes
from carom.state.frame import Frame

HERE = Path(__file__).parent
STORED = HERE / "fingerprints.json"
SCENES = HERE / "scenes"  # made for these tests: they reach contacts within the steps that are run

SpaceMaker = Callable[[Scene, int], Space]  # of a scene and a number of threads
Case = dict[str, Any]  # steps, hashes by part, and counts of what the run came across

AS_WRITTEN = "as written"
ERRORS = ("energy_error", "momentum_error")
SIZES = ("steps", *ERRORS, "impacts", "touching", "in_flight", "held", "sweeps")  # what a person can read
STEPS = 40
OTHER_STEPS = {  # more until something touches, fewer where a step takes milliseconds
    "two-spheres": 350,
    "newtons-cradle": 400,
    "bouncing-ball": 120,
    "billiards": 120,
    "dense-shear": 4,
    "drum": 45,
    "hopper": 50,
    "piston": 230,
    "shaker": 110,
    "shear-cell": 8,
    "rack-break": 450,
    "steady-hopper": 110,
    "marbles-in-a-box": 110,
    "cloud-collapse": 35,
    "asteroid-belt": 10,
    "elastic-gas": 8,
    "five-materials": 235,
    "planet-with-gravel": 10,
    "golden/bounces": 200,
    "golden/orbits": 120,
    "extremes/collapse-3": 80,
    "extremes/heavy-on-top-dropped": 60,
    "extremes/dense-gas": 25,
    "extremes/elastic-chain": 20,
    "extremes/far-origin": 430,
    "extremes/hub-25": 180,
    "extremes/hub-4000": 8,
    "extremes/mass-ratio": 100,
    "extremes/pile-1000": 8,
    "extremes/size-huge": 120,
    "extremes/size-tiny": 120,
    "extremes/stack-20": 140,
    "extremes/stack-200": 6,
    "golden/planets": 160,  # through the encounter, and on
}
FEWER_BODIES = {"extremes/pile-1000": 200, "extremes/hub-4000": 600, "chute": 100}  # placed or run too slowly

CONTACT_VALUES = {
    "contact.solver": ("lasting", "staged"),
    "contact.timing": ("end-of-step", "time-of-impact"),
    "contact.colouring": ("contacts", "bodies"),
    "contact.stabilisation": ("split", "baumgarte", "none"),
    "contact.search": ("grid", "k-d-tree"),
}
INTEGRATORS = ("euler", "leapfrog", "leapfrog-dkd", "yoshida4")
GRAVITY_METHODS = ("direct", "tree")
COMBINATIONS = [
    "contact.solver=staged contact.timing=time-of-impact",
    "contact.solver=staged contact.stabilisation=baumgarte",
    *(f"contact.timing=time-of-impact time.integrator={name}" for name in INTEGRATORS),
]


def golden_scenes() -> dict[str, Path]:
    """Return the path of each scene by its name: the bundled ones, the extremes, and those made for these tests."""
    own = {f"golden/{path.stem}": path for path in sorted(SCENES.glob("*.toml"))}
    return bundled_scenes() | extreme_scenes() | own


def load(name: str, overrides: str) -> Scene:
    """Load a scene with overrides as a case has them: `section.key=value` with blanks between, or "as written"."""
    path = golden_scenes()[name]
    document = tomllib.loads(path.read_text(encoding="utf-8"))
    if name in FEWER_BODIES:
        document["group"][0]["count"] = FEWER_BODIES[name]
    for section, key, value in _overrides(overrides):
        document.setdefault(section, {})[key] = value
    return scene_from_dict(document, DataFiles(path.parent))


def admitted(name: str) -> Iterator[str]:
    """Yield the overrides that make a difference to what a scene computes, and that it does not refuse."""
    yield AS_WRITTEN
    written = load(name, AS_WRITTEN)
    touches = Space(written, 1).requirements.contact.modelled
    pulls = written.gravity.constant > 0.0 and written.gravity.method != "none" and written.count > 1
    for overrides in _variants():
        if ("contact." in overrides and not touches) or ("gravity." in overrides and not pulls):
            continue
        if all(getattr(getattr(written, section), key) == value for section, key, value in _overrides(overrides)):
            continue
        try:
            Space(load(name, overrides), 1)
        except SceneError:
            continue
        yield overrides


def _variants() -> Iterator[str]:
    for key, values in {**CONTACT_VALUES, "gravity.method": GRAVITY_METHODS, "time.integrator": INTEGRATORS}.items():
        yield from (f"{key}={value}" for value in values)
    yield from COMBINATIONS


def _overrides(text: str) -> list[tuple[str, str, str]]:
    """Split overrides into section, key and value."""
    if text == AS_WRITTEN:
        return []
    words = [word.partition("=") for word in text.split()]
    return [(*name.split(".", 1), value) for name, _, value in words]  # type: ignore[misc]


def measured(name: str, overrides: str, steps: int, threads: int, make: SpaceMaker = Space) -> Case:
    """Run a case; return its hashes and counts."""
    space = make(load(name, overrides), threads)
    hashes = {part: xxhash.xxh64() for part in ("energy", "ledger", "time", "contacts", "turning", "state")}
    case: Case = {"steps": 0, "touching": 0, "in_flight": 0, "held": 0, "sweeps": 0}
    for frame in itertools.islice(space.run(schedule=every(0.0)), steps + 1):
        for part, values in _parts(frame, space).items():
            for value in values:
                hashes[part].update(np.ascontiguousarray(value).tobytes())
        case["steps"] = frame.step
        case["touching"] += len(frame.contacts)
        case["in_flight"] += 0 if frame.contacts.into_step is None else len(frame.contacts)
        case["held"] += 0 if frame.memory is None else len(frame.memory.held_pairs)
        case["sweeps"] += frame.sweeps
    extremes = space.extremes
    errors = {name: getattr(extremes, name) for name in ERRORS}
    case |= {name: error and float(f"{error.value:.2g}") for name, error in errors.items()}
    case["impacts"] = extremes.impacts
    case = {name: case[name] for name in SIZES}
    return case | {part: digest.hexdigest() for part, digest in hashes.items()}


def _parts(frame: Frame, space: Space) -> dict[str, list[Any]]:
    """Return the numbers of a frame by the part that they belong to."""
    energy, contacts, memory = frame.energy, frame.contacts, frame.memory
    terms = (energy.translational, energy.rotational, energy.gravitational, energy.field, energy.integration_error)
    by_contacts = (energy.ledger.restitution, energy.ledger.friction, energy.ledger.stabilisation)
    ledger = (*by_contacts, *(loss for _, loss in energy.ledger.forces))
    seen = [contacts.pairs, contacts.normals, contacts.overlaps, contacts.colours]
    held = [memory.pairs, memory.rest_speed, memory.held_pairs, memory.impulse, _floats(memory.kick)] if memory else []
    turning = (space.state.torque, space.state.angular_acceleration)  # of a frame: without those of impacts
    return {
        "energy": [_floats(*terms), frame.momentum, frame.angular_momentum],
        "ledger": [_floats(*ledger)],
        "time": [_floats(frame.step, frame.time, frame.dt, frame.previous_dt), frame.dt_limit.encode()],
        "contacts": [*seen, *([] if contacts.into_step is None else [contacts.into_step]), *held],
        "turning": [*turning],
        "state": [np.uint64(frame.fingerprint), frame.acceleration],
    }


def _floats(*values: float) -> Any:
    return np.array(values, dtype=np.float64)


def stored() -> dict[str, dict[str, Case]]:
    """Read the file: the cases of each scene by their overrides."""
    found: dict[str, dict[str, Case]] = json.loads(STORED.read_text(encoding="utf-8")) if STORED.exists() else {}
    return found


def usual_methods(name: str, cases: dict[str, dict[str, Case]]) -> list[str]:
    """Return all methods for a scene that was made for these tests, and one third of them, in rotation, for others."""
    methods = list(cases[name])
    return methods if name.startswith("golden/") else methods[:1] + methods[1 + sorted(cases).index(name) % 3 :: 3]


def moved(name: str, overrides: str, case: Case, threads: int, make: SpaceMaker = Space) -> str:
    """Run a stored case again; say which parts moved, or nothing."""
    try:
        now = measured(name, overrides, case["steps"], threads, make)
    except SceneError as error:
        return f"{name}, {overrides}: now refused: {error}"
    if all(now.get(part) == case.get(part) for part in (now | case).keys() - set(ERRORS)):
        return ""
    return f"{name}, {overrides}, {case['steps']} steps: {change_of(case, now)}"


def change_of(before: Case, now: Case) -> str:
    """Return the sizes that differ, old and new, and the names of the parts whose bits do."""
    parts = [part for part in now | before if now.get(part) != before.get(part)]
    sizes = [f"{part} {before.get(part)} -> {now.get(part)}" for part in parts if part in SIZES]
    bits = [part for part in parts if part not in SIZES]
    return ", ".join([*sizes, *([f"bits of {', '.join(bits)}"] if bits else [])])


def _written(cases: dict[str, dict[str, Case]]) -> str:
    """Write one case a line, in order, so that a difference shows what moved."""
    scenes = []
    for name, variants in sorted(cases.items()):
        lines = [f"  {json.dumps(overrides)}: {json.dumps(case)}" for overrides, case in sorted(variants.items())]
        scenes.append(f"{json.dumps(name)}: {{\n" + ",\n".join(lines) + "\n}")
    return "{\n" + ",\n".join(scenes) + "\n}\n"


def main(names: list[str]) -> None:
    """Write the fingerprints of all scenes, or of those named; print which cases came, went or changed by how much."""
    scenes = golden_scenes()
    before = stored()
    cases = {name: variants for name, variants in before.items() if name in scenes}
    for name in names or scenes:
        began = time.perf_counter()
        cases[name] = {overrides: _first(name, overrides) for overrides in admitted(name)}
        sys.stdout.write(f"{name}: {len(cases[name])} cases, {time.perf_counter() - began:.2f} s\n")
    for name in sorted(before | cases):
        then, now = before.get(name, {}), cases.get(name, {})
        for overrides in sorted(then | now):
            if overrides in then and overrides in now:
                how = change_of(then[overrides], now[overrides])
            else:
                how = "new" if overrides in now else "gone"
            if how:
                sys.stdout.write(f"{name}, {overrides}: {how}\n")
    STORED.write_text(_written(cases), encoding="utf-8")


def _first(name: str, overrides: str) -> Case:
    return measured(name, overrides, OTHER_STEPS.get(name, STEPS), threads=1)


if __name__ == "__main__":
    main(sys.argv[1:])
