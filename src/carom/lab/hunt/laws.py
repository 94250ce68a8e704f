"""The laws that every scene has to keep, each as a condition that `carom shrink` keeps while it is broken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from carom.lab.hunt.scenes import IMPACTS, SMOOTH
from carom.lab.shrink.condition import Condition, condition_from
from carom.lab.shrink.invariance import applies
from carom.plan.auto import integrator
from carom.plan.features import Requirements, require
from carom.scene.schema import Scene

LEDGER = 1e-9  # of the energy scale, where no force bends the flight: some 10⁶ roundings of 10⁻¹⁶
CONSERVED = 1e-9  # of the largest momentum; likewise


@dataclass(frozen=True, slots=True)
class Law:
    """A law: its name, what it says, the condition that shows it broken, and where it applies."""

    name: str
    says: str
    condition: str
    applies: Callable[[Scene, Requirements], bool]
    kinds: tuple[str, ...] = ()  # of scenes; empty: all

    def broken(self) -> Condition:
        """Return the condition that a run shows if it breaks the law."""
        return condition_from(self.condition)


def laws_of(scene: Scene, kind: str = "") -> list[Law]:
    """Return the laws that apply to a scene of a kind."""
    needs = require(scene)
    return [law for law in LAWS if (not law.kinds or kind in law.kinds) and law.applies(scene, needs)]


def _flies_exactly(scene: Scene, needs: Requirements) -> bool:
    """Tell whether the integrator errs by rounding only, so that the ledger explains every change of the energy."""
    exact = not integrator(scene).controls_error and _falls_exactly(scene)
    pushed = any(scene.gravity.uniform) and any(body.fixed for body in scene.body)  # booked to the next order only
    return exact and not pushed and not needs.gravity.modelled and scene.drag is None


def _falls_exactly(scene: Scene) -> bool:
    """Tell whether bodies fall as they should; with semi-implicit Euler they lose ½ M g² dt² in each step."""
    return integrator(scene).order > 1 or not any(scene.gravity.uniform)


def _is_free(scene: Scene, needs: Requirements) -> bool:
    """Tell whether nothing takes up momentum, and forces between bodies come in exact pairs."""
    return not scene.anchored and not needs.tree.modelled


def _stands(scene: Scene, needs: Requirements) -> bool:
    """Tell whether overlaps at rest are pushed apart: contacts may rest, and no setting leaves them as they are."""
    contact = scene.contact
    pushes = contact.solver == "lasting" and contact.stabilisation == "split" and not contact.allow_overlap
    return needs.resting.modelled and pushes


def _invariance(name: str, says: str, *kinds: str) -> Law:
    return Law(name, says, f"invariance {name}", lambda scene, needs: applies(name, scene), kinds)


ERROR = Law("error", "a run ends at its end or with a stated reason", "crash", lambda scene, needs: True)
LAWS = [
    ERROR,
    Law("finite", "positions, velocities and the energy stay finite", "not finite", lambda scene, needs: True),
    Law("ledger", "the ledger explains every change of the energy", f"energy.max_error > {LEDGER:g}", _flies_exactly),
    Law("momentum", "momentum is conserved", f"momentum.max_error > {CONSERVED:g}", _is_free),
    Law(
        "angular momentum",
        "angular momentum is conserved",
        f"angular_momentum.max_error > {CONSERVED:g}",
        lambda scene, needs: (
            _is_free(scene, needs)
            and scene.domain.boundary == "open"
            and _falls_exactly(scene)
            and not integrator(scene).controls_error
        ),
    ),
    Law(
        "impulses",
        "impulses and forces explain every change of a velocity and of the ledger",
        "expect.contact_audit",
        lambda scene, needs: needs.contact.modelled,
    ),
    Law("overlap", "no overlap above 5 % of a radius lasts", "overlap at rest", _stands),
    Law("replay", "the bits do not depend on threads, checkpoints or the search", "replay differs", lambda *_: True),
    _invariance("scaling", "other units that are powers of two change no bit"),
    _invariance("mirror", "a mirror image has the same bits"),
    _invariance("arrays", "bodies from arrays move as those of the scene, bit for bit"),
    _invariance("translation", "a scene elsewhere runs alike", SMOOTH, IMPACTS),
    _invariance("rotation", "a scene that is turned runs alike", SMOOTH, IMPACTS),
    _invariance("boost", "a scene that moves as a whole runs alike", SMOOTH, IMPACTS),
    _invariance("numbering", "bodies in another order move alike", SMOOTH, IMPACTS),
    _invariance("steps", "the energy error falls with the step as the order of the integrator says", SMOOTH),
]
