"""The optional parts of a step, with the conditions that require them, in the order in which hooks call them."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from typing import NamedTuple

from carom.plan.auto import integrator
from carom.plan.features import Requirements, require
from carom.scene.load import Scene
from carom.scene.scene_file import KeyPath


class StepPart(NamedTuple):
    """An optional part of a step in a scene with contacts."""

    target: str  # module:attribute that makes the part for a contact pipeline; see `carom.physics.contact.hooks`
    # arguments: a scene, its requirements, and whether contacts are recorded
    is_required: Callable[[Scene, Requirements, bool], bool]
    key: KeyPath  # key of the scene that asks for the part
    remedy: Callable[[Scene], str]  # returns the remedy for a user whose installation lacks the part
    # module:attribute of the function that refuses scenes for the part, given a scene, its placed bodies and
    # half-spaces
    refusals: str = ""

    @property
    def is_there(self) -> bool:
        """Whether this installation has the part."""
        try:
            return importlib.util.find_spec(self.target.partition(":")[0]) is not None
        except ModuleNotFoundError:  # the part's package was removed
            return False


def _late(scene: Scene) -> str:
    late = 'contact.timing = "end-of-step"'
    return f'set time.integrator = "leapfrog" and {late}' if integrator(scene).ends_steps_at_impacts else f"set {late}"


STEP_PARTS: dict[str, StepPart] = {
    "sleep": StepPart(
        "carom.physics.contact.sleep.sleepers:make",
        lambda scene, needs, recorded: scene.contact.sleep is not None,
        ("contact", "sleep"),
        lambda scene: "remove contact.sleep",
    ),
    "release": StepPart(
        "carom.physics.contact.release.passage:PassingBodies",
        lambda scene, needs, recorded: scene.admits,
        ("group",),
        lambda scene: "remove the release of all groups",
        refusals="carom.physics.contact.release.passage_checks:refuse_impossible_passages",
    ),
    "walls": StepPart(
        "carom.physics.contact.wall_motion:MovingWalls",
        lambda scene, needs, recorded: bool(scene.wall or scene.translating),
        ("wall",),
        lambda scene: "remove walls, and planes that move",
    ),
    "sheared-contacts": StepPart(
        "carom.physics.shear_motion:ShearedContacts",
        lambda scene, needs, recorded: scene.domain.shear is not None and not needs.impact_time.modelled,
        ("domain", "shear"),
        lambda scene: "remove domain.shear",
    ),
    "time-of-impact": StepPart(
        "carom.physics.contact.events.drift:EventDrivenDrift",
        lambda scene, needs, recorded: needs.impact_time.modelled,
        ("contact", "timing"),
        _late,
    ),
    "plane-guard": StepPart(
        "carom.physics.contact.plane_guard:PlaneGuard",
        lambda scene, needs, recorded: bool(scene.plane or scene.wall or scene.domain.walled),
        ("plane",),
        lambda scene: "remove planes and walls",
    ),
    "contact-tap": StepPart(
        "carom.physics.contact.contact_tap:ContactTap",
        lambda scene, needs, recorded: recorded,
        ("record",),
        lambda scene: "record no contacts",
    ),
}


def refusals_of(scene: Scene) -> list[str]:
    """Return the functions that refuse scenes, for the installed parts that a scene requires."""
    parts = [STEP_PARTS[name] for name in required(scene, require(scene), recorded=False)]
    return [part.refusals for part in parts if part.refusals and part.is_there]


def required(scene: Scene, needs: Requirements, recorded: bool) -> list[str]:
    """Return the names of the parts that a scene requires; ``recorded`` states whether its contacts are recorded."""
    return [name for name, part in STEP_PARTS.items() if part.is_required(scene, needs, recorded)]
