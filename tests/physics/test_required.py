"""A part that a scene does not require is absent; forced on, it changes no bit of the others."""

from __future__ import annotations

import json
import subprocess
import sys
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings

from carom.errors import SceneError
from carom.lab.hunt.documents import Document
from carom.physics.space import Space
from carom.plan.features import require
from carom.scene.load import Scene
from carom.scene.parts import PARTS
from carom.state.frame import Frame
from scene_strategies import documents, scene_from
from small_scenes import cloud, pair, scene_of

SMOOTH = {"static_friction": 0, "restitution": 0.7}
STEPS = 40

Sections = dict[str, Any]

# Scenes that together leave out every part: (name, document)
APART = [{"position": [3.0 * k, 0.5 * k, -k], "velocity": [0.3, -0.2, 0.1]} for k in range(4)]
PILE = [{"position": [0.3 * k, 0.1 * k, 1.0 + 2.0 * k], "velocity": [0.0, 0.1, -0.5]} for k in range(4)]
SCENES: dict[str, Scene] = {
    "a smooth gas": pair(contact=SMOOTH),
    "a smooth gas that spins": cloud(contact=SMOOTH, gravity={"constant": 0.0}),
    "a smooth gas that spins, with times of impact": cloud(
        contact={**SMOOTH, "timing": "time-of-impact"}, gravity={"constant": 0.0}
    ),
    "a smooth cloud that pulls itself together": cloud(group=[{"count": 30, "radius": 0.3}], contact=SMOOTH),
    "bodies that move alike": scene_of(APART, gravity={"constant": 0.0}),
    "bodies that move alike, in steps that end at impacts": scene_of(
        APART, gravity={"constant": 0.0}, time={"integrator": "gauss-radau15"}
    ),
    "a body alone": scene_of(APART[:1]),
    "a smooth pile": scene_of(PILE, plane=[{}], contact=SMOOTH, gravity={"constant": 0.0, "uniform": [0, 0, -9.81]}),
    "a dead gas with friction": cloud(contact={"restitution": 0.0}, gravity={"constant": 0.0}),
    "a fixed step": cloud(time={"fixed_dt": 0.01}),
    "Kepler": Scene.load("kepler-orbits"),
}


def frames_of(scene: Scene, steps: int = STEPS) -> list[Frame]:
    space, frames = Space(scene), []
    for frame in space.run():
        frames.append(frame)
        if frame.step >= steps:
            space.stop()
    return frames


def forced_on(scene: Scene, part: str) -> Scene | None:
    """Return the scene with a part forced on that it does not require; None where that contradicts it.

    Impacts that are forced to their own moments are at other moments: that changes all that follows.
    """
    if part == "time-of-impact" and require(scene).contact.modelled:
        return None
    forced = scene.model_copy(update={"model": scene.model.model_copy(update={"force": (part,)})})
    try:
        require(forced)
    except SceneError as error:
        assert "cannot be forced on" in str(error)
        return None
    return forced


def left_out(scene: Scene) -> list[str]:
    return [part.name for part in require(scene).parts if not part.modelled]


def assert_same_bits(plain: Frame, forced: Frame) -> None:
    """Compare what both have; -0 counts as 0, which a sum with zeros may turn it into."""
    for name in ("position", "velocity", "acceleration", "orientation", "angular_velocity", "torque"):
        ours, theirs = getattr(plain, name), getattr(forced, name)
        if ours is not None:
            assert np.array_equal(ours, theirs), f"{name} at step {plain.step}"
    for name in ("pairs", "normals", "overlaps", "colours"):
        assert np.array_equal(getattr(plain.contacts, name), getattr(forced.contacts, name)), name
    assert (plain.step, plain.time, plain.dt) == (forced.step, forced.time, forced.dt)
    assert plain.energy == forced.energy
    assert np.array_equal(plain.momentum, forced.momentum)
    assert np.array_equal(plain.angular_momentum, forced.angular_momentum)
    assert (plain.sweeps, plain.phase) == (forced.sweeps, forced.phase)
    # after its first line a warning lists the bodies that met, with their spins if they have any
    first_lines = [[(e.step, e.level, e.text.splitlines()[0]) for e in frame.events] for frame in (plain, forced)]
    assert first_lines[0] == first_lines[1]


@pytest.mark.parametrize("name", SCENES)
def test_a_part_that_is_forced_on_changes_no_bit_of_what_remains(name: str) -> None:
    scene = SCENES[name]
    plain = frames_of(scene)
    for part in left_out(scene):
        forced = forced_on(scene, part)
        if forced is not None:
            for ours, theirs in zip(plain, frames_of(forced), strict=True):
                assert_same_bits(ours, theirs)


@settings(max_examples=30, deadline=None)
@given(documents(most_bodies=6))
def test_forcing_all_parts_on_changes_no_bit_of_random_scenes(document: Document) -> None:
    scene = scene_from(document)
    forced = [part for part in left_out(scene) if forced_on(scene, part)]
    everything = scene.model_copy(update={"model": scene.model.model_copy(update={"force": tuple(forced)})})
    for ours, theirs in zip(frames_of(scene, 8), frames_of(everything, 8), strict=True):
        assert_same_bits(ours, theirs)


def test_every_part_is_left_out_by_one_of_the_scenes() -> None:
    always = {"integrator", "energy"}
    assert {part for scene in SCENES.values() for part in left_out(scene)} == set(PARTS) - always


def test_a_part_that_is_not_required_has_no_array() -> None:
    state = Space(SCENES["a smooth gas"]).state
    turning = (state.orientation, state.angular_velocity, state.torque, state.angular_acceleration)
    assert [array.size for array in (*turning, state.ends.angular_velocity)] == [0] * 5
    state = Space(SCENES["a smooth gas that spins"]).state
    assert len(state.orientation) == len(state.angular_velocity) == len(state)
    assert state.torque.size == state.angular_acceleration.size == 0, "it spins, but nothing changes its spin"
    state = Space(pair(contact=SMOOTH, model={"force": "spin"})).state
    assert len(state.angular_velocity) == 2 and state.orientation.size == 0, "spin alone was asked for"
    space = Space(SCENES["Kepler"])
    assert space._contact is None, "no search, no colours, no solver"
    assert Space(SCENES["a smooth gas"])._world.forces._forces == []


def test_frames_do_not_have_what_is_not_required() -> None:
    frame = frames_of(SCENES["a smooth gas that spins"], 1)[-1]
    assert frame.orientation is not None and frame.angular_velocity is not None
    assert frame.torque is None and frame.angular_acceleration is None
    frame = frames_of(SCENES["a smooth gas"], 1)[-1]
    assert frame.orientation is None and frame.angular_velocity is None and frame.memory is None


KERNELS = """
import json, sys
from carom.physics.space import Space
from carom.scene.load import Scene
space = Space(Scene.from_dict(json.loads(sys.argv[1])))
for frame in space.run():
    if frame.step >= 20:
        space.stop()
kernels = {}
for name, module in sorted(sys.modules.items()):
    if name.startswith("carom.physics"):
        for kernel in vars(module).values():
            if getattr(kernel, "signatures", None):
                kernels[kernel.py_func.__module__.removeprefix("carom.physics.") + "." + kernel.py_func.__name__] = 1
print(json.dumps(list(kernels)))
"""

WHOLE: Sections = {
    "body": PILE,
    "plane": [{}],
    "gravity": {"constant": 1e-3, "uniform": [0.0, 0.0, -9.81]},
    "time": {"max_dt": 0.02},
}
DIRECT = {"forces.gravity.direct.sum_few"}
TURNING = {"rotation.rotate_rows", "contact.reactions.write_torques"}
MEETING = {
    "contact.geometry.update_geometry",
    "contact.graph._colour_contacts",
    "contact.solver.phases.work",
}
RESTING = {"contact.islands._write_speeds", "contact.near_pairs._update_largest"}
PUSHING = {"contact.solver.positions.audit_corrections"}  # corrections are a phase of solver.phases.work
FIELD, STEP = {"forces.field.add"}, {"step_rule.target"}
TREE = ("forces.gravity.boxes.", "forces.gravity.tree.")
FAST_MULTIPOLE = ("forces.gravity.fast_multipole.",)
OPTIONAL = ("contact.events.", "forces.drag.", *TREE)  # modules
ALL = DIRECT | TURNING | MEETING | RESTING | PUSHING | FIELD | STEP

LATE = {"timing": "end-of-step"}
CHOICES: list[tuple[str, Sections, set[str]]] = [
    ("the whole model", {}, set()),
    ("without friction", {"contact": SMOOTH}, TURNING),
    ("without gravity and field", {"gravity": {"constant": 0.0}}, DIRECT | FIELD | RESTING),
    ("without pushes", {"contact": {"stabilisation": "none"}}, PUSHING),
    ("without contacts", {"contact": {"enabled": False}}, TURNING | MEETING | RESTING | PUSHING),
    ("at a fixed step", {"time": {"fixed_dt": 0.02}}, STEP),
]
SLOW = ("without gravity and field", "without pushes", "at a fixed step")  # each starts a process


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sections", "absent"),
    [pytest.param(*case, id=name, marks=pytest.mark.slow if name in SLOW else ()) for name, *case in CHOICES],
)
def test_a_part_that_is_not_required_is_neither_compiled_nor_loaded(sections: Sections, absent: set[str]) -> None:
    contact = LATE | sections.get("contact", {})  # impacts on the way have kernels of their own
    loaded = kernels_of(WHOLE | sections | {"contact": contact})
    assert ALL - loaded == absent
    assert not any(name.startswith((*OPTIONAL, *FAST_MULTIPOLE)) for name in loaded)


@pytest.mark.slow
def test_times_of_impact_drag_and_the_tree_load_kernels_of_their_own() -> None:
    gravity = WHOLE["gravity"] | {"method": "tree"}
    drag = {"relaxation_time": 1.0}
    loaded = kernels_of(WHOLE | {"contact": {"timing": "time-of-impact"}, "gravity": gravity, "drag": drag})
    for module in OPTIONAL:
        assert any(name.startswith(module) for name in loaded), f"{module} has no kernels, or another name"


def kernels_of(document: Sections) -> set[str]:
    """Run a scene in a process of its own; return the kernels that it compiled or loaded."""
    arguments = [sys.executable, "-c", KERNELS, json.dumps(document)]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))
