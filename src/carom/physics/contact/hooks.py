"""The hooks of a step: the interface of an optional part of the model, and the order in which a step calls it.

`carom.physics.step` and `carom.physics.contact.pipeline` name no optional part. They call hooks, each with the step,
and a part implements the hooks that it needs. A hook's list has only the methods of parts that implement the hook, so a
scene without parts calls nothing. `carom.plan.step_parts` has a row for each part, in the order in which hooks call
them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from carom.arrays import FloatArray, IntArray
from carom.physics.contact.guided_walls import NO_PUSHES
from carom.physics.contact.impact_log import NO_IMPACTS, Impacts
from carom.physics.diagnostics.run_monitor import Profile
from carom.physics.integrators.kick_drift import DampedPath
from carom.state.checkpoint import ContactCheckpoint

STRAIGHT = DampedPath(0.0, 0.0, 1.0)
NO_ENTRIES: FloatArray = np.zeros((0, 3))


class KickAudit(Protocol):
    """The impulse audit as steps and parts use it; as a context manager, it adds the change of velocities and spins."""

    def add_kick(self, acceleration: FloatArray, dt: float) -> None:
        """Add a kick of (n, 3) m/s² for dt s."""

    def add_force(self, change: FloatArray) -> None:
        """Add changes of velocities by forces, (n, 3) m/s."""

    def __enter__(self) -> None: ...

    def __exit__(self, *error: object) -> None: ...


@dataclass(slots=True)
class PresentStep:
    """The present step."""

    profile: Profile
    before: float = 0.0  # s, time at the beginning of the step
    time: float = 0.0  # s, time at the end of the step
    dt: float = 0.0  # s
    drift: float = 0.0  # s, length of the present drift; some integrators have several in a step
    kick: float = 0.0  # s, length of the kick before the drift; after the first kick, the last step's contacts are held
    booked: float = 0.0  # s, the part of the drift for which the work of the forces is already booked
    last_kick: float = 0.0  # s, length of the kick after the drift
    path: DampedPath = STRAIGHT
    # (n + p, 3) m/s², accelerations that contacts act against; None means the accelerations of the bodies
    against: FloatArray | None = None
    impacts: Impacts = NO_IMPACTS  # impacts during the drift
    audit: KickAudit | None = None
    # (k,) m, displacements of guided walls along their normals by the correction of overlaps
    pushed: FloatArray = field(default_factory=lambda: NO_PUSHES)

    def set_kicks(self, before: float, drift: float, after: float) -> None:
        """Set a drift and the plain kicks before and after it, in s."""
        self.kick = self.booked = before
        self.drift, self.last_kick, self.path = drift, after, DampedPath(before, 0.0, 1.0)


class LedgerAccount(Protocol):
    """The books as optional parts use them; a loss of the bodies is positive in the ledger."""

    def book_work(self, entry: str, work: float) -> None:
        """Book work (J) done on the bodies."""

    def exchange(self, entry: str, loss: float, impulse: FloatArray, angular_impulse: FloatArray) -> None:
        """Book energy that the bodies lost (J), and external impulses (N s and N m s)."""

    def exchanged(self, entry: str) -> FloatArray:
        """Return the energy lost so far, and the expected momenta, (7,)."""
        ...

    def exchange_up_to(self, entry: str, exchanged: FloatArray) -> None:
        """Set the values that `exchanged` returns."""


class WorldForces(Protocol):
    """The forces of a world, for parts that change which bodies the forces move."""

    def find_fixed(self) -> None:
        """Find the bodies that no force moves."""

    def accelerate(self, potential: bool) -> Mapping[str, float]:
        """Update the accelerations of the bodies; return the potential energies (J) if requested."""
        ...

    def potentials(self) -> Mapping[str, float]:
        """Return the potential energies (J) of the present positions."""
        ...


class OptionalPart:
    """An optional part of the model, which overrides the hooks that it needs."""

    entries: tuple[str, ...] = ()  # names of the part's ledger entries; a loss is positive
    pressing_energy = 0.0  # J, work of the part's loads along the smallest radius; the energy scale is at least that
    needs_every_step = True  # whether the part needs every step, so that `few_bodies` can make none

    # Between steps

    def compile(self) -> None:
        """Run the kernels of the hooks without contacts, so that the first contact does not wait for compilation."""

    def join(self, forces: WorldForces) -> None:
        """Note the forces of the world, which is complete now."""

    def forget(self) -> None:
        """Return to the state before the first step."""

    def remember(self, memory: ContactCheckpoint) -> ContactCheckpoint:
        """Return a checkpoint with the state of this part."""
        return memory

    def recall(self, memory: ContactCheckpoint) -> None:
        """Return to the state of a checkpoint."""

    def discard(self) -> None:
        """Discard unbooked energies of the warm-up's steps."""

    def place(self, time: float) -> None:
        """Move walls and images with a prescribed motion to their places at a time (s)."""

    def latest_end(self, time: float, adaptive: bool) -> float:
        """Return the latest end (s) of a step that begins at ``time``; ``adaptive``: whether the scene sets no step."""
        return np.inf

    def is_busy(self) -> bool:
        """Whether the next or the last step differs from a step without this part."""
        return False

    def support(self, by_solver: FloatArray) -> FloatArray:
        """Return the supported accelerations, (n + p,) m/s²; the solver's contacts support ``by_solver``."""
        return by_solver

    def warnings(self) -> Iterable[str]:
        """Return warnings about the limits of the method that the last step reached."""
        return ()

    def losses(self) -> FloatArray:
        """Return the energies lost in the last step that no contact has booked, (k, 3) J, by term of the ledger."""
        return NO_ENTRIES

    def lend(self, account: LedgerAccount) -> None:
        """Let kernels that make many steps continue the entries of the ledger."""

    def settle(self, account: LedgerAccount) -> None:
        """Book the amounts that the kernels added after `lend`."""

    def book(self, account: LedgerAccount) -> None:
        """Book the energy and impulses that the last step exchanged with the bodies."""

    # the methods below are called in this order in a step

    def begin(self, step: int, began: float, ended: float) -> None:
        """Begin the records of a step with a number, given the times of its beginning and end in s."""

    def kick_before(self, step: PresentStep) -> None:
        """Kick before a drift, in place of the plain kick, and set the kicks of the step."""

    def kicked(self, step: PresentStep) -> None:
        """Correct velocities after a plain kick."""

    def prepare(self, step: PresentStep) -> None:
        """Begin a step, after its first kick and before contacts are held."""

    def held(self, step: PresentStep) -> None:
        """Note the impulses of the contacts of the last step, now that they are held."""

    def depart(self, step: PresentStep) -> None:
        """Begin a drift."""

    def move(self, step: PresentStep) -> None:
        """Move the bodies; without a part with this hook, they move along straight lines."""

    def struck(self, step: PresentStep) -> None:
        """Note impacts during the drift."""

    def arrive(self, step: PresentStep) -> None:
        """Move everything but bodies to the end of the step, and put back bodies that left the allowed space."""

    def search(self, step: PresentStep, others: Callable[[PresentStep], IntArray]) -> IntArray:
        """Return the contacts, (m, 2), among the pairs that the search ``others`` returns."""
        return others(step)

    def restarted(self) -> None:
        """Copy the records of held contacts before the solver overwrites them."""

    def load(self, dt: float) -> None:
        """Raise the largest speeds of contacts at rest in a step of dt seconds."""

    def corrected(self, step: PresentStep) -> None:
        """Note that overlaps are corrected."""

    def travelled(self, step: PresentStep) -> None:
        """End a drift, after overlaps are corrected and before bodies are wrapped."""

    def wrap(self, step: PresentStep) -> None:
        """Wrap the bodies into a periodic box whose images move."""

    def kick_after(self, step: PresentStep) -> None:
        """Kick after a drift, in place of the plain kick."""

    def finish(self, step: PresentStep) -> None:
        """Note the last kick, before contacts are resolved."""

    def before_impacts(self, step: PresentStep) -> None:
        """Give walls the accelerations of the last kick, before contacts are resolved."""

    def after_impacts(self, step: PresentStep) -> None:
        """Note the impacts at the end of the step, before contacts are held."""

    def acted(self, step: PresentStep) -> None:
        """Note all impulses of contacts at the end of the step."""

    def conclude(self, step: PresentStep) -> None:
        """Add this part's numbers to the statistics of the step."""

    def end(self, step: PresentStep) -> None:
        """Change velocities at the end of the step."""


class Mover(OptionalPart):
    """A part that moves the bodies through a drift, and resolves impacts there."""

    def resolve_meeting(self, pair: tuple[int, int] | None, dt: float) -> Impacts:
        """Resolve the impacts of touching pairs after a step of dt s; without a ``pair``, only load the kernels."""
        raise NotImplementedError

    def step_by_impacts(self, span: float) -> float:
        """Return the longest step (s) that the next impact allows; infinite if there is none within a span (s)."""
        raise NotImplementedError


P = TypeVar("P", bound=OptionalPart)
StepHooks = list[Callable[[PresentStep], None]]


class Hooks(NamedTuple):
    """The methods of the parts that implement each hook, in the order of the parts."""

    latest_end: list[Callable[[float, bool], float]]
    is_busy: list[Callable[[], bool]]
    support: list[Callable[[FloatArray], FloatArray]]
    lend: list[Callable[[LedgerAccount], None]]
    settle: list[Callable[[LedgerAccount], None]]
    book: list[Callable[[LedgerAccount], None]]
    begin: list[Callable[[int, float, float], None]]
    kick_before: StepHooks
    kicked: StepHooks
    prepare: StepHooks
    held: StepHooks
    depart: StepHooks
    move: StepHooks
    struck: StepHooks
    arrive: StepHooks
    search: list[Callable[..., IntArray]]
    load: list[Callable[[float], None]]
    corrected: StepHooks
    travelled: StepHooks
    wrap: StepHooks
    kick_after: StepHooks
    finish: StepHooks
    before_impacts: StepHooks
    after_impacts: StepHooks
    acted: StepHooks
    conclude: StepHooks
    end: StepHooks

    @classmethod
    def of(cls, parts: Iterable[OptionalPart]) -> Hooks:
        """Return the hooks of parts, given in their order."""
        kinds = [(part, type(part)) for part in parts]
        return cls(
            *(
                [getattr(part, name) for part, kind in kinds if getattr(kind, name) is not getattr(OptionalPart, name)]
                for name in cls._fields
            )
        )
