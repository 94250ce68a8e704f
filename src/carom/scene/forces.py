"""The forces: the conditions under which each is modelled, and the names of its recorded energies.

`FORCES` lists carom's own forces. A force of an installed package is a `BodyForce` or a `PairForce`, which acts in
scenes with a section ``[forces.NAME]``. The parts of the model, `carom explain`, the energy terms and ledger entries of
a recording, and the reports are derived from its `ForceKind`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

from carom.scene.installed_forces import BodyForce, force_called
from carom.scene.scene_model import SceneModel
from carom.scene.units.dimension import ACCELERATION, GRAVITATIONAL_CONSTANT, TIME, VELOCITY


@dataclass(frozen=True, slots=True)
class ForceKind:
    """A force: the condition under which it is modelled, and the name of its energy."""

    name: str  # name of the part of the model and, with underscores, of the force's module
    decide: Callable[[SceneModel], tuple[bool, str]]  # returns whether the force is modelled, and why
    potential: str = ""  # term of the energy, if the force has a potential
    loss: str = ""  # entry in the ledger, if the force has no potential
    legend: str = ""  # legend of its energy series
    meaning: str = ""  # meaning of the energy series, for docs/recording.md
    colour: str = ""  # colour of the energy series, a name in the palette of curves
    flag: str = ""  # key in the properties of a recording; by default `has_` and the short name
    # whether the force accelerates all bodies at rest equally
    pushes: Callable[[SceneModel], bool] = lambda scene: False
    differs: bool = False  # whether bodies at rest accelerate differently, so that they may be pressed together
    damps: bool = False  # whether the force depends on velocities, and is solved within the drift
    part: str = ""  # part of the model that the energy series requires; by default the force itself
    # why ``model.force`` cannot switch the force on; empty if it can
    contradiction: Callable[[SceneModel], str] = lambda scene: ""

    @property
    def short_name(self) -> str:
        """The last word of the name, for the profile and for flags."""
        return self.name.rpartition("-")[2]

    @property
    def present(self) -> str:
        """The flag in the recordings of scenes with this force."""
        return self.flag or f"has_{self.short_name}"

    @property
    def recorded_with(self) -> str:
        """The part of the model that the force's energy series requires."""
        return self.part or self.name


def _gravity(scene: SceneModel) -> tuple[bool, str]:
    if scene.gravity.method == "none":
        return False, 'gravity.method = "none"'
    if scene.gravity.constant == 0:
        return False, "gravity.constant = 0"
    if scene.count == 1:
        return False, "a single body attracts nothing else"
    constant = scene.unit_system.text(scene.gravity.constant, GRAVITATIONAL_CONSTANT, "g")
    return True, f"{scene.count} bodies, G = {constant}"


def _uniform_field(scene: SceneModel) -> tuple[bool, str]:
    if any(scene.gravity.uniform):
        return True, f"gravity.uniform = {scene.unit_system.vector(scene.gravity.uniform, ACCELERATION)}"
    return False, "gravity.uniform is zero"


def _drag(scene: SceneModel) -> tuple[bool, str]:
    if scene.drag is None:
        return False, "no [drag]"
    units = scene.unit_system
    velocity = units.vector(scene.drag.medium_velocity, VELOCITY)
    moving = f", a medium that moves with {velocity}" if _medium_moves(scene) else ""
    return True, f"drag.relaxation_time = {units.text(scene.drag.relaxation_time, TIME, 'g')}{moving}"


def _medium_moves(scene: SceneModel) -> bool:
    return scene.drag is not None and any(scene.drag.medium_velocity)


GRAVITY = ForceKind(
    "gravity",
    _gravity,
    potential="gravitational",
    legend="gravitational",
    meaning="of the bodies' own gravity",
    colour="purple",
    flag="gravitates",
    differs=True,
    part="potential",
    contradiction=lambda scene: 'gravity.method = "none"; remove it' if scene.gravity.method == "none" else "",
)
UNIFORM_FIELD = ForceKind(
    "uniform-field",
    _uniform_field,
    potential="field",
    legend="uniform field",
    meaning="potential energy in the uniform field",
    colour="green",
    pushes=lambda scene: any(scene.gravity.uniform),
)
DRAG = ForceKind(
    "drag",
    _drag,
    loss="drag",
    legend="drag",
    meaning="removed by the drag of the medium since the start; negative if a moving medium added more",
    colour="purple",
    pushes=_medium_moves,
    damps=True,
    contradiction=lambda scene: "there is no medium; add [drag] with a relaxation_time",
)
# largest dt/τ of a step with drag and exact impacts; the fraction e⁻⁸ of a velocity remains, with 12 digits
MOST_RELAXATIONS = 8.0
FORCES = (GRAVITY, UNIFORM_FIELD, DRAG)  # forces in the order in which their accelerations are added


@cache
def kind_called(name: str) -> ForceKind:
    """Return the kind of a force by its name: a force of carom or of an installed package."""
    own = next((kind for kind in FORCES if kind.name == name), None)
    if own is not None:
        return own
    force = force_called(name)
    removed = f"removed by the force {name} since the start; negative if it added energy"

    def decide(scene: SceneModel) -> tuple[bool, str]:
        given = scene.forces.given
        return (True, f"[forces.{name}]") if name in given else (False, f"no [forces.{name}]")

    return ForceKind(
        name,
        decide,
        potential=name if force.potential else "",
        loss="" if force.potential else name,
        legend=force.legend or name,
        meaning=force.meaning or (f"potential energy of the force {name}" if force.potential else removed),
        colour=force.colour,
        differs=True,
        contradiction=lambda scene: f"there is none; add [forces.{name}]",
    )


def acts_from_outside(scene: SceneModel) -> bool:
    """Return whether a force of an installed package acts on single bodies, so that it changes the momentum."""
    return any(isinstance(force_called(name), BodyForce) for name in scene.forces.given)


def kinds_of(scene: SceneModel) -> tuple[ForceKind, ...]:
    """Return carom's own forces and the scene's forces of installed packages, in the order of summation."""
    return (*FORCES, *(kind_called(name) for name in scene.forces.given))
