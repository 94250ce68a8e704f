"""The energy of a state: its terms, and the ledger of energy that contacts and forces have moved."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated

from carom.state.saved import Saved

NamedEnergies = tuple[tuple[str, float], ...]  # J, energies by ledger entry or energy term; hashable


@dataclass(frozen=True, slots=True)
class Ledger:
    """Energy moved by contacts, forces without a potential and moving walls since the start of the run, in joules.

    The energy moved by contacts is computed from the impulses themselves. Dissipation is positive when energy leaves
    the bodies, stabilisation when it enters them.
    """

    restitution: Annotated[float, Saved("ledger_restitution", "J")] = 0.0  # energy removed by normal impulses
    friction: Annotated[float, Saved("ledger_friction", "J")] = 0.0  # energy removed by tangential impulses
    # J, energy added by pushing overlapping bodies apart (Baumgarte bias or split)
    stabilisation: Annotated[float, Saved("ledger_stabilisation", "J")] = 0.0
    # J, energy removed by forces without a potential and by moving walls, by entry
    forces: Annotated[NamedEnergies, Saved("ledger_", "J", is_named=True)] = ()

    def entry(self, name: str) -> float:
        """Return an entry by its name in the recording, in joules."""
        forces = dict(self.forces)
        return forces[name] if name in forces else float(getattr(self, name))

    def plus_loss(self, entry: str, loss: float) -> Ledger:
        """Return the ledger after a force without a potential has removed ``loss`` more joules."""
        return self.with_loss(entry, dict(self.forces).get(entry, 0.0) + loss)

    def with_loss(self, entry: str, loss: float) -> Ledger:
        """Return the ledger after a force without a potential has removed ``loss`` joules in total."""
        return replace(self, forces=tuple({**dict(self.forces), entry: loss}.items()))

    @property
    def balance(self) -> float:
        """The energy that left the bodies minus the energy that entered them."""
        by_contacts = self.restitution + self.friction - self.stabilisation
        return by_contacts + self.by_forces if self.forces else by_contacts

    @property
    def by_forces(self) -> float:
        """The energy removed by forces without a potential; negative if a moving medium added more."""
        return sum(loss for _, loss in self.forces)

    @property
    def taken_out(self) -> float:
        """The energy removed by contacts; a negative entry is an error, and counts as 0."""
        return max(0.0, self.restitution) + max(0.0, self.friction)


@dataclass(frozen=True, slots=True)
class Energy:
    """The terms of the total energy at one moment, in joules.

    ``integration_error`` is E(t) + dissipated(t) - injected(t) - E(0), the error of the integrator alone.
    """

    translational: Annotated[float, Saved("energy_translational", "J")]  # Σ ½ m v²
    rotational: Annotated[float, Saved("energy_rotational", "J")]  # Σ ½ I ω²
    gravitational: Annotated[float, Saved("energy_gravitational", "J")]  # J, -Σ G m_i m_j / √(r_ij² + ε²)
    field: Annotated[float, Saved("energy_field", "J")]  # J, -Σ m g·x in the uniform field
    ledger: Ledger
    integration_error: Annotated[float, Saved("energy_integration_error", "J")]
    scale: Annotated[float, Saved("energy_scale", "J")]  # J, scale of relative errors; see `EnergyAccount`
    # J, potentials of other forces, by term
    others: Annotated[NamedEnergies, Saved("energy_", "J", is_named=True)] = ()
    rounding: float = 0.0  # J, change of the total that may be rounding; 0 if the scale is far larger

    def term(self, name: str) -> float:
        """Return a term by its name in the recording, in joules."""
        others = dict(self.others)
        return others[name] if name in others else float(getattr(self, name))

    def named(self, name: str) -> float:
        """Return a term, the total, an entry of the ledger or the integration error by its name in the recording (J).

        Raises AttributeError for any other name.
        """
        own = ("translational", "rotational", "gravitational", "field", "total", "integration_error")
        return self.term(name) if name in own or name in dict(self.others) else self.ledger.entry(name)

    @property
    def total(self) -> float:
        """Sum of the terms."""
        total = self.translational + self.rotational + self.gravitational + self.field
        for _, energy in self.others:
            total += energy
        return total

    @property
    def undamped(self) -> float:
        """The total plus the energy dissipated by forces without a potential, in J; contacts can only lower it."""
        return self.total + self.ledger.by_forces if self.ledger.forces else self.total

    @property
    def relative_error(self) -> float:
        """Magnitude of the integration error relative to the energy scale; 0 if it may be rounding of the total."""
        return abs(self.relative_change(self.integration_error))

    def relative_change(self, change: float) -> float:
        """Return a change of the total (J) relative to the energy scale; 0 if it may be rounding of the total."""
        return 0.0 if abs(change) <= self.rounding else self.relative(change)

    def relative(self, energy: float) -> float:
        """Return an energy (J) relative to the energy scale; ±1 for any energy if the scale is 0."""
        if self.scale > 0.0:
            return energy / self.scale
        return 0.0 if energy == 0.0 else math.copysign(1.0, energy)


@dataclass(frozen=True, slots=True)
class Origin:
    """Terms at the start, in joules, on which the energy scale is based."""

    conserved: float  # J, kinetic + gravitational energy, relative to the centre of mass if nothing is fixed
    rotational: float
    field: float  # J, energy in the uniform field and in all other forces but gravity


@dataclass(frozen=True, slots=True)
class EnergyBaseline:
    """Reference values of the energy."""

    initial: float  # J, total energy at the start of the run
    scale: float  # J, largest scale of the checks so far
    origin: Origin
