"""The terms of the energy, and their balance with the ledger.

    E = Σ ½ m v² + Σ ½ I ω² - Σ G m_i m_j / √(r_ij² + ε²) - Σ m g·x
    integration error = E(t) + dissipated(t) - injected(t) - E(0)

The error is relative to the energy scale: the conserved total or, if it is larger, the energy that the field and the
spins exchange with this total (docs/physics.md, 11).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from carom.arrays import FloatArray
from carom.physics.bodies import Bodies
from carom.physics.diagnostics.momentum import TotalMotion, internal_energy
from carom.scene.forces import GRAVITY, UNIFORM_FIELD
from carom.state.energies import Energy, EnergyBaseline, Ledger, Origin

_PULL, _FIELD = GRAVITY.potential, UNIFORM_FIELD.potential
CANCELLED = 1e-8  # largest sum of kinetic and gravitational energy, relative to their magnitudes, that counts as 0
EPSILON = float(np.finfo(np.float64).eps)
WALKS = 4.0  # standard deviations of the random walk of roundings that count as rounding; see `Energy.rounding`
RESOLVED = 1e-10  # largest rounding, relative to the energy scale, that cannot be mistaken for an error


class EnergyAccount:
    """Computes the `Energy` of a state, relative to the start of the run and the largest energy scale so far.

    The scale is the largest value, in the checks so far and in the state itself, of these energies:

    - |E_c - (restitution + friction) + stabilisation - drag|, where E_c is the kinetic and gravitational energy at the
      start: the conserved total, minus the energy removed by contacts and drag, plus the energy added by stabilisation;
    - the energy that the other forces and the spins exchanged with this total, |ΔE_field|, |drag| and |ΔE_rotational|;
    - Σ m |g| r, if there is a field, and ``pressing`` (J), the same energy for loads: bodies that rest on a plane have
      no other energy.

    If kinetic and gravitational energy cancel at the start, as on a parabola, E_c is the sum of their magnitudes.
    Speeds in E_c are relative to fixed bodies and walls or, without these, relative to the centre of mass. E_c excludes
    the energy between fixed bodies, ``constant`` (J). ``field``, (3,) m/s², includes the acceleration by a moving
    medium. With ``spins_count``, the scale includes the rotational energy itself: another engine may change it without
    a contact.
    """

    def __init__(
        self,
        bodies: Bodies,
        field: FloatArray,
        anchored: bool = False,
        constant: float = 0.0,
        pressing: float = 0.0,
        spins_count: bool = False,
    ) -> None:
        self._bodies = bodies
        self._spins_count = spins_count
        self._anchored = anchored
        self._constant = constant
        lift = np.sqrt((field**2).sum()) * (bodies.mass * bodies.radius).sum()
        self._lift = float(lift) + pressing  # J, Σ m |g| r plus the work of loads over a radius
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

        ``judged`` marks a check; the scale of later checks is at least as large as its scale. ``roundings`` is the
        number of steps and impacts so far, since each of these rounds velocities.
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
        # terms of a sum and changes of velocities are rounded up or down at random
        changing = translational + abs(gravitational - self._constant) + abs(external)
        changing += rotational if ledger.friction else 0.0  # without friction, nothing changes the spins
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
