"""The audit of a run: compares energy and momentum at every check with the start, and warns of a rise of energy."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from carom.errors import PhysicsError
from carom.event import Event
from carom.physics.bodies import Bodies
from carom.physics.checkpoint import Books
from carom.physics.contact.pipeline import ContactPipeline
from carom.physics.diagnostics.energy import Energy, EnergyAccount, EnergyBaseline
from carom.physics.diagnostics.energy_monitor import EnergyMonitor, MonitorState, Suspects
from carom.physics.diagnostics.extremes import Extremes
from carom.physics.diagnostics.ledger import Ledger
from carom.physics.diagnostics.momentum import Momentum, MomentumAccount, MomentumBaseline
from carom.physics.diagnostics.motion import Motion
from carom.plan.auto import integrator
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME
from carom.scene.wording import Names

FloatArray = NDArray[np.float64]

ROUNDING = 1e-10  # of a sum over 10⁶ bodies, at most


class Audit:
    """Energy and momentum as of the last check; the first one is the start of the run.

    Parameters
    ----------
    scene
        The scene, for its field, boundary and energy tolerance.
    bodies
        The state at the start.
    names
        Names for warnings.
    uniform
        (3,) m/s², acceleration that is the same for all bodies.
    constant
        J, the gravitational energy of fixed bodies among each other.
    losses
        The ledger's entries for forces without a potential.
    """

    def __init__(
        self,
        scene: Scene,
        bodies: Bodies,
        names: Names,
        uniform: FloatArray,
        constant: float = 0.0,
        losses: Iterable[str] = (),
    ) -> None:
        periodic = scene.domain.boundary == "periodic"
        self.ledger = Ledger(forces=tuple((entry, 0.0) for entry in losses))
        self.energy: Energy
        self.momentum: Momentum
        self.step = -1  # of the last check
        self._bodies = bodies
        self._units = scene.unit_system
        self._energy = EnergyAccount(bodies, uniform, scene.anchored, constant)
        booked = len(self.ledger.forces) > 0  # step by step, the field too: the centre of mass moves on no parabola
        self._momentum = MomentumAccount(bodies, np.zeros(3) if booked else uniform, periodic, scene.anchored)
        self._watch = EnergyMonitor(scene.record.energy_tolerance, names, integrator(scene), scene.unit_system)
        self._suspects: Suspects | None = None
        self._spent: Suspects | None = None  # those of the last check; their arrays are used again

    @property
    def energy_baseline(self) -> EnergyBaseline:
        """The reference values of the energy."""
        assert self._energy.baseline is not None, "the stock of the start has been taken"
        return self._energy.baseline

    @property
    def momentum_baseline(self) -> MomentumBaseline:
        """The reference values of the momenta."""
        return self._momentum.baseline

    @property
    def monitor_state(self) -> MonitorState:
        """The state of the energy monitor between two checks."""
        return self._watch.tally

    def reopen(self, books: Books, ledger: Ledger) -> None:
        """Continue the audit of an earlier run."""
        self.ledger = ledger
        self._energy.baseline, self._momentum.baseline, self._watch.tally = books.energy, books.momentum, books.watch
        self._suspects = None

    def refer_to(self, books: Books) -> bool:
        """Take the references of a recorded start that differ from these by rounding; return whether one did.

        Versions before 23 November 2026 summed the centre of mass and Σ m |g| r with BLAS, whose rounding depends on
        the processor.
        """
        energy, momentum = self.energy_baseline, self.momentum_baseline
        known = replace(energy, scale=_nearly(books.energy.scale, energy.scale, energy.scale))
        reach = float(np.abs(self._bodies.position).max())
        pairs = zip(books.momentum.centre, momentum.centre, strict=True)
        x, y, z = (_nearly(recorded, own, reach) for recorded, own in pairs)
        moved = replace(momentum, centre=(x, y, z))
        changed = (known, moved) != (energy, momentum)
        self._energy.baseline, self._momentum.baseline = known, moved
        return changed

    def book(self, contacts: FloatArray) -> None:
        """Book the energies of the contacts of a step, (m, 3) J."""
        self.ledger = self.ledger.plus(contacts)

    def exchange(self, entry: str, loss: float, impulse: FloatArray, angular_impulse: FloatArray) -> None:
        """Book the energy that a force without a potential took out, in J, and its impulses, in N s and N m s."""
        self.ledger = self.ledger.plus_loss(entry, loss)
        self._momentum.receive(impulse, angular_impulse)

    def suspect(self, step: int, contact: ContactPipeline) -> None:
        """Keep the contacts of a step for a possible warning, before the next step overwrites them."""
        self._suspects = self._spent = Suspects.of(step, contact, self._bodies, self._spent)

    def energy_now(self, potentials: Mapping[str, float]) -> Energy:
        """Return the energy of the present state, given the potential energies of the forces in joules."""
        return self._energy.balance(Motion.of(self._bodies), potentials, self.ledger)

    def momentum_now(self, time: float) -> Momentum:
        """Return the momentum of the present state, at a time in seconds."""
        return self._momentum.balance(Motion.of(self._bodies), time)

    def take_stock(self, step: int, time: float, potentials: Mapping[str, float], extremes: Extremes) -> None:
        """Compute energy and momentum, and update the extremes of the run with their errors.

        Raises
        ------
        PhysicsError
            If the energy is no longer finite.
        """
        motion = Motion.of(self._bodies)
        self.energy = self._energy.balance(motion, potentials, self.ledger)
        if not math.isfinite(self.energy.total):
            raise PhysicsError(f"the energy is no longer finite at step {step}, t = {self._units.text(time, TIME)}")
        extremes.see_energy(step, time, self.energy)
        self.momentum = self._momentum.balance(motion, time)
        extremes.see_momentum(step, time, self.momentum)
        self.step = step

    def check(self, time: float, extremes: Extremes, contact: ContactPipeline | None = None) -> list[Event]:
        """Check the energy; return the warnings of the energy monitor.

        They list the contacts that were kept, and those of ``contact``, if they may have changed the energy, too.
        """

        def suspects() -> list[Suspects]:
            present = Suspects.of(self.step, contact, self._bodies) if contact else None
            return [found for found in (self._suspects, present) if found]

        warnings = self._watch.check(self.step, time, self.energy, extremes.contact_gain.value, suspects)
        self._suspects = None
        return warnings


def _nearly(recorded: float, own: float, size: float) -> float:
    """Return a recorded value if it is the own one but for rounding, otherwise the own one."""
    return recorded if abs(recorded - own) <= ROUNDING * size else own
