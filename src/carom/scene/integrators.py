"""The table of integrators, used by the scene's key, the checks, the step and the comparisons.

A step is a sequence of substeps: a kick with the old forces, a drift, and a kick with the new forces, for fractions of
dt:

    v += a(x) before dt,    x += v drift dt,    v += a(x) after dt

Leapfrog in kick-drift-kick form is of order 2 and symplectic at a constant step. Drift-kick-drift exchanges kicks and
drifts: on a Kepler orbit, the energy then oscillates only a quarter as much, but forces belong to the middle of the
step. Yoshida's fourth order consists of three leapfrog steps of w₁ dt, w₀ dt, w₁ dt with w₁ = 1/(2 - 2^{1/3}), w₀ = 1 -
2 w₁ (Yoshida 1990, Phys. Lett. A 150, 262).

Installed packages may add sequences of substeps. Two integrators are not such sequences: Gauss–Radau integration
chooses its step by its error, Wisdom–Holman integration by the shortest orbit (`carom.physics.integrators.gauss_radau`,
`carom.physics.integrators.wisdom_holman`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from carom import registry

AUTO = "auto"  # value of time.integrator with which carom chooses an integrator


class Substep(NamedTuple):
    """Fractions of dt for a kick with the old forces, a drift, and a kick with the new forces."""

    before: float
    drift: float
    after: float


@dataclass(frozen=True, slots=True)
class Integrator:
    """An integrator of the motion between contacts."""

    name: str  # value of `time.integrator`
    title: str  # name in descriptions
    order: int  # order in dt of the error after a fixed time
    substeps: tuple[Substep, ...]  # parts of a step; empty if the integrator chooses its own steps
    hierarchical: bool = False  # whether the integrator needs a body that dominates all others

    @property
    def controls_error(self) -> bool:
        """Whether the integrator chooses its steps by its own error or orbits, whatever the scene's limits."""
        return not self.substeps

    @property
    def ends_with_forces(self) -> bool:
        """Whether a kick uses the forces at the end of a step: the last kick, or the first kick of the next step."""
        return self.controls_error or self.substeps[-1].after != 0.0 or self.substeps[0].before != 0.0

    @property
    def holds_contacts(self) -> bool:
        """Whether contacts may be at rest, which requires the forces at the end of the step."""
        return self.ends_with_forces and not self.controls_error

    @property
    def steps_back(self) -> bool:
        """Whether a substep goes backward in time."""
        return any(substep.drift < 0.0 for substep in self.substeps)

    @property
    def drifts_once(self) -> bool:
        """Whether a step is a single drift, within which impacts can be resolved."""
        return len(self.substeps) == 1

    @property
    def ends_steps_at_impacts(self) -> bool:
        """Whether a step ends where bodies meet."""
        return self.controls_error and not self.hierarchical

    @property
    def locates_impacts(self) -> bool:
        """Whether impacts can be resolved at their exact times: within the only drift, or by ending the step there."""
        return self.drifts_once or self.ends_steps_at_impacts

    @property
    def damps(self) -> bool:
        """Whether drag is supported, which requires a single drift between two equal kicks (docs/physics.md, 6)."""
        return self.drifts_once and self.substeps[0].before == self.substeps[0].after

    @property
    def keeps_accuracy(self) -> bool:
        """Whether the integrator's errors fall fast enough to be measured, so that a look-ahead can choose the step."""
        return self.controls_error or (self.order > 1 and self.ends_with_forces)

    @property
    def force_sums(self) -> int:
        """Number of force evaluations per step; a lower bound if the number of iterations depends on the error."""
        if self.controls_error:
            return 1 if self.hierarchical else 8  # 8 is the number of nodes of Gauss–Radau integration
        return len(self.substeps) - (not self.ends_with_forces)


ENCOUNTERS_BY = "gauss-radau15"  # integrator that takes over from hierarchical integrators in close encounters
_W1 = 1.3512071919596578  # 1 / (2 - 2^{1/3})
_W0 = 1.0 - 2.0 * _W1

INTEGRATORS = {
    integrator.name: integrator
    for integrator in (
        Integrator("euler", "semi-implicit Euler", 1, (Substep(1.0, 1.0, 0.0),)),
        Integrator("leapfrog", "leapfrog", 2, (Substep(0.5, 1.0, 0.5),)),
        Integrator(
            "leapfrog-dkd",
            "leapfrog as drift-kick-drift (not where contacts may press)",
            2,
            (Substep(0.0, 0.5, 1.0), Substep(0.0, 0.5, 0.0)),
        ),
        Integrator("yoshida4", "Yoshida's", 4, tuple(Substep(0.5 * w, w, 0.5 * w) for w in (_W1, _W0, _W1))),
        Integrator("gauss-radau15", "Gauss–Radau with steps chosen by its own error", 15, ()),
        Integrator("wisdom-holman", "Wisdom–Holman about a dominant body (without contacts)", 2, (), hierarchical=True),
    )
}


def integrator_called(name: str) -> Integrator:
    """Return an integrator by its name: an integrator of carom, or a sequence of substeps of an installed package.

    Raises
    ------
    ExtensionError
        If there is no integrator of that name, or it cannot be used.
    """
    own = INTEGRATORS.get(name)
    if own is not None:
        return own
    given = registry.load("integrators", name)
    if not (isinstance(given, Integrator) and given.name == name and given.substeps):
        raise registry.ExtensionError(
            f'the integrator "{name}" of the package {registry.source_of("integrators", name)} is no `Integrator` of '
            "that name with substeps"
        )
    return given


def described() -> str:
    """List the integrators with their orders, for the description of the scene's key."""
    *others, last = (f"{each.title} (order {each.order})" for each in INTEGRATORS.values())
    return f"{', '.join(others)} or {last}"
