"""Conditions on whole runs that no single frame can show: invariances, replays that differ, shorter steps, commands.

An invariance compares a scene with its image: the scene in other units, mirrored, translated, rotated or renumbered.
The image must have the same motion. The image has positions x' = L (A x) + s + u t' at times t' = T t, and bodies in
another order. Powers of two and changes of sign are exact in floating point, so images that use only these must have
the same bits. Other images may deviate by as much as a run whose initial state is rounded, times a factor for the
roundings in all steps.
"""

from __future__ import annotations

import copy
import math
import shlex
import subprocess
import tomllib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from carom.arrays import FloatArray
from carom.errors import ExperimentError, PhysicsError, SceneError
from carom.lab.run_summary import Observation, said_by
from carom.lab.shrink.literal import BODIES, Document, with_value
from carom.lab.shrink.trials import Condition
from carom.physics.placement import place
from carom.physics.schedule import every
from carom.physics.simulation import StepStatus
from carom.physics.space import Space
from carom.plan import auto
from carom.plan.features import require
from carom.private_folder import temporary_folder
from carom.runs.refinement import refine
from carom.scene.conversion import converted, rescaled
from carom.scene.load import Scene
from carom.scene.units.dimension import BASE, LENGTH, Dimension
from carom.scene.wording import suggestion
from carom.state.checkpoint import Checkpoint

EPS = float(np.finfo(np.float64).eps)
PERTURBED = 6  # number of runs that measure the growth of roundings
ROUNDINGS = 1e3  # allowed deviation of an image, in deviations of perturbed runs: it is rounded in every step, not once
KNOWN = 1e-6  # largest growth of roundings, relative to the extent, for which there is a verdict
FINER = 16  # factor on the number of steps: the error falls by 16 at order 1, by 256 at order 2
FALLS = 64.0  # smallest factor by which the error must fall with an integrator of order 2 or more


@dataclass(frozen=True, slots=True)
class Image:
    """A transformation of scenes."""

    matrix: FloatArray = field(default_factory=lambda: np.eye(3))  # orthogonal matrix A
    length: float = 1.0  # factor L
    mass: float = 1.0
    time: float = 1.0  # factor T
    shift: FloatArray = field(default_factory=lambda: np.zeros(3))  # m, vector s
    boost: FloatArray = field(default_factory=lambda: np.zeros(3))  # m/s, vector u
    backwards: bool = False  # whether the order of bodies is reversed
    exact: bool = True  # whether the bits must be the same

    def positions(self, position: FloatArray, time: float) -> FloatArray:
        """Return the positions of the image, (n, 3) m, at its time."""
        found = self.length * (position @ self.matrix.T) + self.shift + self.boost * time
        return np.asarray(found[::-1] if self.backwards else found)

    def velocities(self, velocity: FloatArray) -> FloatArray:
        """Return the velocities of the image, (n, 3) m/s."""
        found = (self.length / self.time) * (velocity @ self.matrix.T) + self.boost
        return np.asarray(found[::-1] if self.backwards else found)

    def of(self, document: Document) -> Document:
        """Return the image of a scene."""

        def factor(dimension: Dimension) -> float:
            sizes = {"length": self.length, "time": self.time, "mass": self.mass, "angle": 1.0}
            powers = zip(BASE, dimension.exponents, strict=True)
            return float(np.prod([sizes[name] ** power for name, power in powers]))

        changed = copy.deepcopy(dict(rescaled(document, factor)))
        for body in changed.get(BODIES, []):
            self._change(body, "position", self.shift)
            if not body.get("fixed"):
                self._change(body, "velocity", self.boost)
            self._change(body, "angular_velocity", np.zeros(3), axial=True)
        for plane in changed.get("plane", []):
            self._change(plane, "point", self.shift)
            if "normal" in plane or not np.array_equal(self.matrix, np.eye(3)):
                plane.setdefault("normal", [0.0, 0.0, 1.0])
                self._change(plane, "normal", np.zeros(3))
            motion = plane.get("motion", {})
            for key in ("velocity", "amplitude"):
                self._change(motion, key, np.zeros(3))
            if "velocities" in motion:
                motion["velocities"] = [[float(v) for v in self.matrix @ np.array(one)] for one in motion["velocities"]]
        if "uniform" in changed.get("gravity", {}):
            self._change(changed["gravity"], "uniform", np.zeros(3))
        if "drag" in changed:
            self._change(changed["drag"], "medium_velocity", self.boost)
        return changed | {BODIES: changed[BODIES][::-1]} if self.backwards else changed

    def _change(self, section: Document, key: str, offset: FloatArray, axial: bool = False) -> None:
        if key not in section and not offset.any():
            return
        sign = np.linalg.det(self.matrix).round() if axial else 1.0
        found = sign * (self.matrix @ np.array(section.get(key, [0.0, 0.0, 0.0]), dtype=np.float64)) + offset
        section[key] = [float(value) for value in found]


def _extent(space: Space) -> float:
    position = space.state.position
    return float(np.ptp(position, axis=0).max()) or float(np.abs(position).max()) or 1.0


IMAGES: dict[str, Callable[[Space], Image]] = {
    "scaling": lambda space: Image(length=2.0**9, mass=2.0**-7, time=2.0**4),
    "mirror": lambda space: Image(matrix=np.diag([1.0, -1.0, 1.0])),
    "translation": lambda space: Image(shift=1e3 * _extent(space) * np.array([1.0, -0.5, 0.25]), exact=False),
    "boost": lambda space: Image(
        boost=1e3 * _extent(space) / space.scene.time.duration * np.array([-0.5, 0.25, 1.0]), exact=False
    ),
    "rotation": lambda space: Image(matrix=np.asarray(Rotation.from_quat([1, 2, -2, 3]).as_matrix()), exact=False),
    "numbering": lambda space: Image(backwards=True, exact=False),
}
INVARIANCES = (*IMAGES, "steps", "arrays")


@dataclass(frozen=True, slots=True)
class FinalState:
    """The state and error at the end of a run."""

    step: int
    time: float  # s
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    error: str

    @classmethod
    def of(cls, space: Space) -> FinalState:
        """Run a space to its end."""
        error = ""
        try:
            for _ in space.run(schedule=every(space.scene.time.duration)):
                pass
        except Exception as raised:  # a fault in the engine may be the failure itself
            error = said_by(raised)
        return cls(space.step, space.time, space.state.position.copy(), space.state.velocity.copy(), error)


INSTANTS = 50  # number of times at which a run is compared with its repetition at shorter steps


@dataclass(frozen=True, slots=True)
class MovesWithSteps(Condition):
    """A run that changes noticeably if its steps are a quarter as long."""

    of_whole_run = True

    def pinned(self, seen: Observation) -> MovesWithSteps:
        """Return this condition, if it holds."""
        if not self.holds(seen):
            raise ExperimentError("nothing to shrink: shorter steps tell the same story")
        return self

    def holds(self, seen: Observation) -> bool:
        """Return whether shorter steps change the run noticeably."""
        return bool(self.said(seen))

    def said(self, seen: Observation) -> str:
        """Describe the first difference; empty if there is none."""
        return "" if seen.error else moved_by_shorter_steps(seen.space.scene)


def moved_by_shorter_steps(
    scene: Scene, most_steps: float = math.inf, watch: Callable[[StepStatus], None] = lambda status: None
) -> str:
    """Describe the first change caused by steps a quarter as long; empty if there is none, or if a run fails."""
    try:
        moved = refine(scene, threads=1, instants=INSTANTS, most_steps=most_steps, watch=watch).moved
    except (SceneError, PhysicsError):
        return ""
    return moved[0].text(scene.unit_system) if moved else ""


@dataclass(frozen=True, slots=True)
class Varies(Condition):
    """The violation of an invariance."""

    name: str  # name in `INVARIANCES`
    of_whole_run = True

    def check(self, seen: Observation) -> None:
        """Check the name."""
        if self.name not in INVARIANCES:
            hint = suggestion(self.name, INVARIANCES)
            raise ExperimentError(f"--while {self.text}: no invariance {self.name}; {hint}")

    def pinned(self, seen: Observation) -> Varies:
        """Return this condition, if it holds."""
        if not self.holds(seen):
            raise ExperimentError(f"nothing to shrink: the result does not change under {self.name}")
        return self

    def holds(self, seen: Observation) -> bool:
        """Return whether the run and its image differ."""
        return bool(self.said(seen))

    def said(self, seen: Observation) -> str:
        """Describe the difference; empty if there is none."""
        scene = seen.space.scene
        if seen.error or scene.bodies or not applies(self.name, scene):
            return ""
        try:
            match self.name:
                case "steps":
                    return _by_shorter_steps(scene)
                case "arrays":
                    return _by_arrays(scene)
            return _by_image(scene, IMAGES[self.name])
        except (SceneError, PhysicsError):  # the image is refused
            return ""


def applies(name: str, scene: Scene) -> bool:
    """Return whether carom promises an invariance for a scene."""
    needs = require(scene)
    match name:
        case "scaling":
            return True
        case "steps":
            return scene.time.fixed_dt is not None and not needs.contact.modelled
        case "arrays":
            # with a group, the step follows from the smallest radius that the group allows; with arrays, from the
            # smallest radius present
            draws = any(group.radius.min < group.radius.max for group in scene.group)
            return not (draws or scene.material or scene.unit_system.converts or scene.admits)
        case "boost" if scene.plane or scene.anchored:
            return False
        case _ if scene.admits:  # images cannot have inlets or outlets
            return False
    # ties at borders of a tree or a box break the symmetry, and walls have an order
    return not (scene.group or scene.domain.boundary != "open" or scene.wall or needs.tree.modelled)


def _by_arrays(scene: Scene) -> str:
    """Compare the bits of a scene with the bits of the same scene whose bodies are given as arrays."""
    start = place(scene)
    kept = {key: value for key, value in tomllib.loads(scene.toml).items() if key not in (BODIES, "group")}
    names = ("position", "velocity", "angular_velocity", "mass", "radius", "inertia", "fixed")
    arrays: dict[str, Any] = {name: getattr(start, name) for name in names}
    given = Scene.from_arrays(**arrays, name=list(start.name), **kept)
    here, there = FinalState.of(Space(scene, threads=1)), FinalState.of(Space(given, threads=1))
    same = (here.step, here.time, bool(here.error)) == (there.step, there.time, bool(there.error))
    return (
        ""
        if same and np.array_equal(here.position, there.position)
        else "the bits differ if bodies are given as arrays"
    )


def _by_image(scene: Scene, image_of: Callable[[Space], Image]) -> str:
    document = _explicit(scene)
    space = Space(Scene.from_dict(document), threads=1)
    start = space.state.position.copy(), space.state.velocity.copy()
    image = image_of(space)
    here, there = FinalState.of(space), FinalState.of(Space(Scene.from_dict(image.of(document)), threads=1))
    if here.error or there.error:
        return "" if bool(here.error) == bool(there.error) else f"one ends with: {here.error or there.error}"
    if here.step != there.step:
        return f"it takes {there.step} steps instead of {here.step}"
    position = image.positions(here.position, there.time)
    if image.exact:
        same = np.array_equal(there.position, position) and here.time * image.time == there.time
        return "" if same and np.array_equal(there.velocity, image.velocities(here.velocity)) else "the bits differ"
    reach = max(float(np.abs(all_).max()) for all_ in (start[0], here.position, there.position))
    speed = max(float(np.abs(all_).max()) for all_ in (start[1], here.velocity, there.velocity))
    allowed = ROUNDINGS * (_grown(document, here, reach, speed) + EPS * reach)
    off = float(np.abs(there.position - position).max())
    if off <= allowed or not allowed <= KNOWN * _extent(space):
        return ""
    units = scene.unit_system
    explained = units.text(allowed, LENGTH, ".1g")
    return f"a position differs by {units.text(off, LENGTH, '.3g')}, and rounding explains only {explained}"


def _grown(document: Document, here: FinalState, reach: float, speed: float) -> float:
    """Return the final distance (m) between runs whose starts differ by the rounding of a position and a speed."""
    found = 0.0
    for seed in range(PERTURBED):
        rng = np.random.default_rng(seed)
        bodies = []
        for body in document[BODIES]:
            changed = dict(body)
            for key, size in (("position", reach), ("velocity", speed)):
                if not body.get("fixed"):
                    nudge = 4.0 * EPS * size * rng.choice([-1.0, 1.0], 3)
                    changed[key] = [float(x) for x in np.array(body.get(key, [0.0, 0.0, 0.0])) + nudge]
            bodies.append(changed)
        there = FinalState.of(Space(Scene.from_dict(document | {BODIES: bodies}), threads=1))
        if there.error or there.step != here.step:
            return np.inf
        found = max(found, float(np.abs(there.position - here.position).max()))
    return found


def _by_shorter_steps(scene: Scene) -> str:
    """Compare the largest energy error with the error at shorter steps."""
    assert scene.time.fixed_dt is not None, "the steps are fixed"
    shorter = scene.time.model_copy(update={"fixed_dt": scene.time.fixed_dt / FINER})
    coarse, fine = _energy_error(scene), _energy_error(scene.model_copy(update={"time": shorter}))
    floor = 1e-11  # smallest error that counts, relative to the energy scale: some 10⁵ roundings
    if coarse is None or fine is None or fine <= max(coarse / FALLS, floor):
        return ""
    return f"the energy error is {coarse:.3g}, and {fine:.3g} with steps {FINER} times shorter: it decreases too little"


def _energy_error(scene: Scene) -> float | None:
    """Run a scene; return its largest energy error relative to the scale; None if it fails."""
    energies = (frame.energy for frame in Space(scene, threads=1).run(schedule=every(0.0)))
    try:
        return max((one.relative_error for one in energies), default=0.0)
    except Exception:
        return None


def _explicit(scene: Scene) -> Document:
    """Return a scene as a document in the units of the simulation, including defaults with dimensions."""
    quantities, units, _ = converted(tomllib.loads(scene.toml))
    document: Document = {key: value for key, value in quantities.items() if key != "expect"}
    if units.converts:
        del document["units"]
    defaults = {("time", "duration"): scene.time.duration}
    if math.isfinite(largest := auto.largest_step(scene)):
        defaults["time", "max_dt"] = largest
    for (section, key), value in (defaults | {("gravity", "constant"): scene.gravity.constant}).items():
        if key not in document.get(section, {}):
            document = with_value(document, (section, key), value)
    start = place(scene) if not scene.group else None
    for k, body in enumerate(document.get(BODIES, []) if start else []):
        assert start is not None
        body.setdefault("radius", float(start.radius[k]))
        if "density" not in body:
            body.setdefault("mass", float(start.mass[k]))
    return document


@dataclass(frozen=True, slots=True)
class CommandShows(Condition):
    """A command that exits with 0 if a scene shows the failure."""

    of_whole_run = True

    def pinned(self, seen: Observation) -> CommandShows:
        """Run the command twice; refuse a command that does not report the failure both times."""
        codes = [self._code(seen.space.scene) for _ in range(2)]
        if (codes[0] == 0) != (codes[1] == 0):
            raise ExperimentError(
                f"--while-command is flaky: of two runs on the same scene one exited with {codes[0]}, the other with "
                f"{codes[1]}; make it exit with the same code each time"
            )
        if codes[0] != 0:
            raise ExperimentError(
                f"nothing to shrink: the command exited with {codes[0]}; 0 means that the scene shows the failure"
            )
        return self

    def holds(self, seen: Observation) -> bool:
        """Return whether the command exits with 0."""
        return self._code(seen.space.scene) == 0

    def said(self, seen: Observation) -> str:
        """State that the command reported the failure."""
        return "the command exits with 0"

    def _code(self, scene: Scene) -> int:
        with temporary_folder() as folder:
            path = folder / "scene.toml"
            path.write_text(scene.toml, encoding="utf-8")
            quoted = shlex.quote(str(path))
            line = self.text.replace("{}", quoted) if "{}" in self.text else f"{self.text} {quoted}"
            ran = subprocess.run(line, shell=True, check=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        return ran.returncode


@dataclass(frozen=True, slots=True)
class ReplayDiffers(Condition):
    """Two runs with different bits: with other threads, from a checkpoint, or with the other search."""

    difference: str = ""  # name of the run that differs; empty: any run
    of_whole_run = True

    def pinned(self, seen: Observation) -> ReplayDiffers:
        """Return the condition that runs differ in the same way."""
        difference = self._difference(seen)
        if not difference:
            raise ExperimentError(
                "nothing to shrink: runs on two threads, from a checkpoint and with the other search have the same bits"
            )
        return replace(self, difference=difference)

    def holds(self, seen: Observation) -> bool:
        """Return whether the runs differ."""
        difference = self._difference(seen)
        return bool(difference) and self.difference in ("", difference)

    def said(self, seen: Observation) -> str:
        """Describe the difference."""
        return f"a run {self.difference} ends with different bits"

    def _difference(self, seen: Observation) -> str:
        """Return the name of the run that differs from the first; empty if none differs."""
        scene, expected = seen.space.scene, _ending(seen.space, seen.error)
        other, middle = _run(Space(scene, threads=2), seen.space.step // 2)
        if other != expected:
            return "on two threads"
        if middle is None:
            return ""
        restored = Space(scene, threads=1)
        restored.restore(middle)
        if _run(restored)[0] != expected:
            return "from a checkpoint"
        search = "grid" if scene.contact.search == "k-d-tree" else "k-d-tree"
        contact = scene.contact.model_copy(update={"search": search})
        found = _run(Space(scene.model_copy(update={"contact": contact}), threads=1))[0]
        return "" if found == expected else "with the other contact.search"


def _ending(space: Space, error: str) -> tuple[int, int, str]:
    return space.step, space.fingerprint(), error


def _run(space: Space, middle: int = 0) -> tuple[tuple[int, int, str], Checkpoint | None]:
    """Run a space to its end; return its final state, and its state after step ``middle``."""
    kept = None
    try:
        for frame in space.run(schedule=every(0.0)):
            if frame.step == middle and middle > 0:
                kept = frame.checkpoint
    except Exception as error:
        return _ending(space, said_by(error)), None
    return _ending(space, ""), kept
