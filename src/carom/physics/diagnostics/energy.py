"""The terms of the energy, and their balance with the ledger.

    E = Σ ½ m v² + Σ ½ I ω² - Σ G m_i m_j / √(r_ij² + ε²) - Σ m g·x
    integration error = E(t) + dissipated(t) - injected(t) - E(0)

The error is relative to the energy scale: the conserved total or, if larger, the energy that the field and the spins
exchange with it (docs/physics.md, 11).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Annotated

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.diagnostics.ledger import Ledger, NamedEnergies
from carom.physics.diagnostics.momentum import TotalMotion, internal_energy
from carom.physics.saved import Saved
from carom.scene.forces import GRAVITY, UNIFORM_FIELD

_PULL, _FIELD = GRAVITY.potential, UNIFORM_FIELD.potential
CANCELLED = 1e-8  # of the sum of magnitudes; a smaller sum of kinetic and gravitational energy counts as 0
EPSILON = float(np.finfo(np.float64).eps)
WALKS = 4.0  # standard deviations of a random walk of roundings; see `Energy.rounding`
RESOLVED = 1e-10  # of the energy scale; smaller roundings cannot be mistaken for an error


@dataclass(frozen=True, slots=True)
class Energy:
    """The terms of the total energy at one moment, in joules.

    ``integration_error`` is E(t) + dissipated(t) - injected(t) - E(0), the error of the integrator alone.
    """

    translational: Annotated[float, Saved("energy_translational", "J")]  # Σ ½ m v²
    rotational: Annotated[float, Saved("energy_rotational", "J")]  # Σ ½ I ω²
    gravitational: Annotated[float, Saved("energy_gravitational", "J")]  # -Σ G m_i m_j / √(r_ij² + ε²)
    field: Annotated[float, Saved("energy_field", "J")]  # -Σ m g·x, of the uniform field
    ledger: Ledger
    integration_error: Annotated[float, Saved("energy_integration_error", "J")]
    scale: Annotated[float, Saved("energy_scale", "J")]  # scale of relative errors; see `EnergyAccount`
    # of the potentials of other forces, by their terms
    others: Annotated[NamedEnergies, Saved("energy_", "J", is_named=True)] = ()
    rounding: float = 0.0  # J, up to which a change of the total may be rounding; 0 where the scale is far above it

    def term(self, name: str) -> float:
        """Return a term by its name in the recording, in joules."""
        others = dict(self.others)
        return others[name] if name in others else float(getattr(self, name))

    def named(self, name: str) -> float:
        """Return a term, the total, an entry of the ledger or the integration error by its name in the recording (J).

        Raises AttributeError if it has another name.
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
        """|integration error| over the energy scale; 0 within the rounding of the total."""
        return abs(self.relative_change(self.integration_error))

    def relative_change(self, change: float) -> float:
        """Return a change of the total (J) relative to the energy scale; 0 within the rounding of the total."""
        return 0.0 if abs(change) <= self.rounding else self.relative(change)

    def relative(self, energy: float) -> float:
        """Return an energy (J) relative to the energy scale; ±1 for any energy if the scale is 0."""
        if self.scale > 0.0:
            return energy / self.scale
        return 0.0 if energy == 0.0 else math.copysign(1.0, energy)


@dataclass(frozen=True, slots=True)
class Origin:
    """Terms at the start, in joules, on which the energy scale is based."""

    conserved: float  # kinetic + gravitational, relative to the centre of mass if nothing is fixed
    rotational: float
    field: float  # of the uniform field and all other forces but gravity


@dataclass(frozen=True, slots=True)
class EnergyBaseline:
    """Reference values of the energy."""

    initial: float  # J, the total at the start of the run
    scale: float  # J, the largest scale of the checks so far
    origin: Origin


class EnergyAccount:
    """Computes the `Energy` of a state, relative to the start of the run and the largest energy scale so far.

    The scale is the largest, among the checks so far and the state itself, of

    - |E_c - (restitution + friction) + stabilisation - drag|, where E_c is the kinetic and gravitational energy at the
      start: the conserved total, less the energy removed by contacts and drag, plus the energy added by stabilisation;
    - the energy that the other forces and the spins exchanged with it, |ΔE_field|, |drag| and |ΔE_rotational|;
    - Σ m |g| r, if there is a field: bodies that rest on a plane have no other energy.

    If kinetic and gravitational energy cancel at the start, as on a parabola, E_c is the sum of their magnitudes.
    Speeds in E_c are relative to fixed bodies and walls, or without them to the centre of mass. E_c excludes the energy
    between fixed bodies, ``constant`` (J). ``field``, (3,) m/s², includes the acceleration by a moving medium. With
    ``spins_count``, the scale includes the rotational energy itself: another engine may change it without a contact.
    """

    def __init__(
        self,
        bodies: Bodies,
        field: FloatArray,
        anchored: bool = False,
        constant: float = 0.0,
        spins_count: bool = False,
    ) -> None:
        self._bodies = bodies
        self._spins_count = spins_count
        self._anchored = anchored
        self._constant = constant
        lift = np.sqrt((field**2).sum()) * (bodies.mass * bodies.radius).sum()
        self._lift = float(lift)  # J, Σ m |g| r
        self.baseline: EnergyBaseline | None = None  # None before the first call

    def balance(
        self,
        motion: TotalMotion,
        potentials: Mapping[str, float],
        ledger: Ledger,
        judged: bool = True,
        roundings: int = 0,
    ) -> Energy:
        """Return the energy, given the potential energies of the forces; the first call sets the initial values.

        ``judged`` marks a check; the scale of later checks is at least as large. ``roundings`` is the number of steps
        and impacts so far, each of which has rounded velocities.
        """
        translational, rotational = motion.translational, motion.rotational
        others = dict(potentials)
        gravitational, of_field = others.pop(_PULL, 0.0), others.pop(_FIELD, 0.0)
        external = of_field + sum(others.values()) if others else of_field
        total = translational + rotational + gravitational + external
        if self.baseline is None:
            moving = translational if self._anchored else internal_energy(self._bodies.velocity, self._bodies.mass)
            binding = gravitational - self._constant
            conserved, cancelling = moving + binding, moving + abs(binding)
            if abs(conserved) < CANCELLED * cancelling:
                conserved = cancelling
            self.baseline = EnergyBaseline(total, self._lift, Origin(conserved, rotational, external))
        known = self.baseline
        scale = max(
            known.scale,
            abs(known.origin.conserved),
            abs(known.origin.conserved - ledger.taken_out + ledger.stabilisation - ledger.by_forces),
            abs(ledger.by_forces),
            abs(external - known.origin.field),
            abs(rotational - known.origin.rotational),
            rotational if self._spins_count else 0.0,
        )
        if judged and scale != known.scale:
            self.baseline = replace(known, scale=scale)
        # each term of a sum, and each change of a velocity, is rounded up or down at random
        changing = translational + abs(gravitational - self._constant) + abs(external)
        changing += rotational if ledger.friction else 0.0  # otherwise nothing has changed the spins
        summed = changing + rotational + abs(self._constant) + abs(known.initial)
        walk = changing * math.sqrt(roundings) + summed * math.sqrt(1.0 + len(self._bodies))
        rounding = WALKS * EPSILON * walk
        return Energy(
            translational=translational,
            rotational=rotational,
            gravitational=gravitational,
            field=of_field,
            ledger=ledger,
            integration_error=total - known.initial + ledger.balance,
            scale=scale,
            others=tuple(others.items()),
            rounding=rounding if rounding > RESOLVED * scale else 0.0,
        )
