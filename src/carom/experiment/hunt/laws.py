"""The laws that every scene has to keep, each as a condition that `carom shrink` keeps while it is broken."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from carom.experiment.shrink.condition import Condition, condition_from
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

    def broken(self) -> Condition:
        """Return the condition that a run shows if it breaks the law."""
        return condition_from(self.condition)


def laws_of(scene: Scene) -> list[Law]:
    """Return the laws that apply to a scene."""
    needs = require(scene)
    return [law for law in LAWS if law.applies(scene, needs)]


def _flies_exactly(scene: Scene, needs: Requirements) -> bool:
    """Tell whether the integrator errs by rounding only, so that the ledger explains every change of the energy."""
    return not needs.gravity.modelled and scene.drag is None and not integrator(scene).controls_error


def _is_free(scene: Scene, needs: Requirements) -> bool:
    """Tell whether nothing takes up momentum, and forces between bodies come in exact pairs."""
    return not scene.anchored and not needs.tree.modelled


LAWS = [
    Law("error", "a run ends at its end or with a stated reason", "crash", lambda scene, needs: True),
    Law("ledger", "the ledger explains every change of the energy", f"energy.max_error > {LEDGER:g}", _flies_exactly),
    Law("momentum", "momentum is conserved", f"momentum.max_error > {CONSERVED:g}", _is_free),
    Law(
        "angular momentum",
        "angular momentum is conserved",
        f"angular_momentum.max_error > {CONSERVED:g}",
        lambda scene, needs: _is_free(scene, needs) and scene.domain.boundary == "open",
    ),
    Law(
        "impulses",
        "impulses and forces explain every change of a velocity and of the ledger",
        "expect.contact_audit",
        lambda scene, needs: needs.contact.modelled,
    ),
    Law("replay", "the bits do not depend on threads, checkpoints or the search", "replay differs", lambda *_: True),
]
