"""`Space`: the public API of a simulation."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carom.arrays import FloatArray
from carom.event import Event
from carom.physics.contact.contact_tap import Impulses
from carom.physics.contact.impact_log import NO_IMPACTS, Impacts
from carom.physics.look_ahead.find_step import with_promise
from carom.physics.look_ahead.trial_run import Watcher
from carom.physics.placement import place
from carom.physics.reference_api import BodyProxy
from carom.physics.schedule import Goal, at, every
from carom.physics.simulation import Simulation
from carom.plan.checks import refuse_impossible
from carom.scene.load import Scene
from carom.scene.start import InitialBodies
from carom.state.books import Extremes
from carom.state.energies import Energy, Ledger

ONE_STEP = Goal(end=np.inf, schedule=at(()), checks=at(()), most=1)


class Space(Simulation):
    """A simulation of a scene, with the API of the reference engine and more.

    Only one thread may step a space. Meanwhile, other threads may only read ``status`` and call ``stop``.

    Parameters
    ----------
    scene
        The scene to simulate.
    threads
        Number of threads for the kernels, by default one per core. The bits do not depend on it.
    start
        Initial states of the bodies, by default as the scene places them.
    stride
        Largest factor by which the scene's steps are multiplied, for a coarse look-ahead; the method may allow less.
        `foreseen` counts the scene's own steps.
    record_contacts
        Whether frames carry impacts and the contact table, in `Frame.impacts` and `Frame.contact_rows`. The bits do
        not depend on it.
    watch_look_ahead
        Called with a `WorkBudget` while trial runs determine the step that keeps an accuracy.

    Raises
    ------
    SceneError
        If the scene cannot run on this machine or in this version, or its bodies cannot be placed.
    TypeError
        If the scene is not a `Scene`.
    ValueError
        If the number of threads is not a whole number of at least 1.
    """

    def __init__(
        self,
        scene: Scene,
        threads: int | None = None,
        start: InitialBodies | None = None,
        stride: float = 1.0,
        record_contacts: bool = False,
        watch_look_ahead: Watcher | None = None,
    ) -> None:
        if not isinstance(scene, Scene):
            raise TypeError(f"Space: a Scene is needed, not {type(scene).__name__}; make one by Scene.load(path)")
        if threads is not None and not (isinstance(threads, int) and threads >= 1):
            raise ValueError(
                f"Space: threads = {threads!r}: must be a whole number from 1 on, or None for one per core"
            )
        refuse_impossible(scene)
        start = start or place(scene)
        super().__init__(with_promise(scene, threads, start, watch_look_ahead), start, threads, stride, record_contacts)

    @property
    def foreseen(self) -> dict[str, float]:
        """Number of the scene's own steps so far, by the limit that set them."""
        return self._world.clock.foreseen

    @property
    def extremes(self) -> Extremes:
        """The extremes of the run so far."""
        return self._books.extremes

    @property
    def records_contacts(self) -> bool:
        """Whether frames carry impacts and the contact table."""
        return self._records_contacts

    @property
    def ledger(self) -> Ledger:
        """The energies removed and added by contacts and forces since the start of the run."""
        return self._books.audit.ledger

    @property
    def impacts(self) -> Impacts:
        """The impacts during the drift of the last step, in order of time; empty with end-of-step timing."""
        return Impacts(self._contact.impacts.log.copy()) if self._contact else NO_IMPACTS

    @property
    def bodies(self) -> list[BodyProxy]:
        """A view of each body, in the order of the scene."""
        return [BodyProxy(self.state, index) for index in range(len(self.state))]

    def impulses(self) -> Iterator[Impulses]:
        """Yield the impulses of the last step in the order in which they acted, if contacts are recorded."""
        return self._tap.impulses() if self._tap else iter(())

    def kicks(self) -> list[FloatArray]:
        """Return the changes of the velocities by forces in the last step, in order, each (n, 3) m/s.

        The list is empty unless the scene sets ``expect.contact_audit``.
        """
        audit = self._books.impulse_audit
        return [] if audit is None else audit.kicks

    def compute_dynamics(self, iteration: int) -> None:
        """Compute one step.

        Parameters
        ----------
        iteration
            Number of the step; the energy is checked at every ``record.check_every``-th step.

        Raises
        ------
        PhysicsError
            If the state is no longer finite.
        TypeError
            If the number is not an integer.
        """
        if not isinstance(iteration, int | np.integer):
            raise TypeError(f"iteration: expected the number of the step, got {iteration!r}")
        is_check = iteration % self.scene.record.check_every == 0
        self._advance(ONE_STEP._replace(checks=every(0.0)) if is_check else ONE_STEP)

    def get_body_data_for_display(self) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """Return positions (n, 3), quaternions (n, 4) xyzw, torques (n, 3) and angular accelerations (n, 3) as copies.

        Torques (N m) and angular accelerations (rad/s²) are due to lasting contacts only, as in a `Frame`. If the scene
        requires no orientations or torques, the result contains the identity and zeros in their place.
        """
        state, n, needs = self.state, len(self.state), self.requirements
        orientation = state.orientation if needs.orientation.modelled else np.tile([0.0, 0.0, 0.0, 1.0], (n, 1))
        torque, alpha = np.zeros((n, 3)), np.zeros((n, 3))
        if needs.torque.modelled:
            torque, alpha = state.torque.copy(), state.angular_acceleration.copy()
            self.without_impacts(torque, alpha)
        return state.position.copy(), orientation.copy(), torque, alpha

    def energy(self) -> Energy:
        """Return the present energy: terms, ledger and integration error."""
        return self._books.energy_now(self._world.forces.potentials())

    def momentum(self) -> FloatArray:
        """Total momentum Σ m v, (3,) kg m/s."""
        return self._books.audit.momentum_now(self.time).linear

    def angular_momentum(self) -> FloatArray:
        """Total angular momentum Σ (m x × v + I ω) about the origin, (3,) kg m²/s."""
        return self._books.audit.momentum_now(self.time).angular

    def highlights(self) -> tuple[Event, ...]:
        """Return the extremes of the run so far as events, each at its own time."""
        return self.extremes.highlights(self._world.names, self.scene.unit_system)

    def named_extremes(self) -> Extremes:
        """Return the extremes of the run so far, with the names of bodies and planes."""
        return self.extremes.named(self._world.names)
