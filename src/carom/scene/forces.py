"""The table of forces. It decides when each force is modelled, and names its recorded energies.

To add a force, write a section of the scene (`schema`), a row here, and ``carom/physics/forces/NAME.py`` with a
function ``make`` (see `carom.physics.forces.force`). The parts of the model, `carom explain`, the energy terms and
ledger entries of a recording, and the reports follow from the row.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from carom.scene.units.dimension import ACCELERATION, GRAVITATIONAL_CONSTANT, TIME, VELOCITY

if TYPE_CHECKING:
    from carom.scene.schema import Scene


@dataclass(frozen=True, slots=True)
class ForceKind:
    """A force: when it is modelled, and the name of its energy."""

    name: str  # of the part of the model; with underscores, of the module that computes the force
    decide: Callable[[Scene], tuple[bool, str]]  # whether it is modelled, and why
    potential: str = ""  # its term of the energy, if it has a potential
    loss: str = ""  # its entry in the ledger, if it has no potential
    legend: str = ""  # of the series of its energy
    meaning: str = ""  # of that series, for docs/recording.md
    colour: str = ""  # of that series, by its name in the palette of curves
    flag: str = ""  # in the properties of a recording; by default `has_` and the short name
    pushes: Callable[[Scene], bool] = lambda scene: False  # whether it accelerates all bodies at rest alike
    differs: bool = False  # whether it accelerates bodies at rest differently, so that they may meet and press
    damps: bool = False  # whether it depends on velocities, and is solved within the drift
    part: str = ""  # without which that series is not recorded; by default the force itself
    contradiction: Callable[[Scene], str] = lambda scene: ""  # why ``model.force`` cannot switch it on; empty if it can

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
        """The part of the model without which the series of its energy is not recorded."""
        return self.part or self.name


def _gravity(scene: Scene) -> tuple[bool, str]:
    if scene.gravity.method == "none":
        return False, 'gravity.method = "none"'
    if scene.gravity.constant == 0:
        return False, "gravity.constant = 0"
    if scene.count == 1:
        return False, "one body pulls nothing else"
    constant = scene.unit_system.text(scene.gravity.constant, GRAVITATIONAL_CONSTANT, "g")
    return True, f"{scene.count} bodies, G = {constant}"


def _no_gravity_method(scene: Scene) -> str:
    return 'gravity.method = "none"; leave that out' if scene.gravity.method == "none" else ""


def _uniform_field(scene: Scene) -> tuple[bool, str]:
    if any(scene.gravity.uniform):
        return True, f"gravity.uniform = {scene.unit_system.vector(scene.gravity.uniform, ACCELERATION)}"
    return False, "gravity.uniform is zero"


def _drag(scene: Scene) -> tuple[bool, str]:
    if scene.drag is None:
        return False, "no [drag]"
    units = scene.unit_system
    velocity = units.vector(scene.drag.medium_velocity, VELOCITY)
    moving = f", a medium that moves with {velocity}" if _medium_moves(scene) else ""
    return True, f"drag.relaxation_time = {units.text(scene.drag.relaxation_time, TIME, 'g')}{moving}"


def _medium_moves(scene: Scene) -> bool:
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
    contradiction=_no_gravity_method,
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
    meaning="taken out by the drag of the medium since the start; negative if a moving medium put more in",
    colour="purple",
    pushes=_medium_moves,
    damps=True,
    contradiction=lambda scene: "there is no medium; add [drag] with a relaxation_time",
)
FORCES = (GRAVITY, UNIFORM_FIELD, DRAG)  # in the order in which their accelerations are summed
