"""What "auto" stands for in a scene: gravity method, integrator, timing, limits of the step, frame interval."""

from __future__ import annotations

from typing import Literal

from carom.plan import contacts, pulls
from carom.plan.forced import forced_parts
from carom.scene.forces import GRAVITY
from carom.scene.integrators import AUTO, INTEGRATORS, Integrator
from carom.scene.schema import Scene

FRAMES = 600  # of an "auto" recording: more than a person scrubs through, few enough to open at once
FEWEST_FRAMES = 50
AUTO_BYTES = 300_000_000  # an "auto" recording of many bodies gets fewer frames to stay below
BYTES_PER_BODY_AND_FRAME = 60  # centre, quaternion, and about one arrow or edge

MANY = 100  # bodies, from which on an "auto" step is a tenth of the fall from rest through the smallest radius
STEP_PER_BODY = 1e-3  # of that fall; fewer bodies cost next to nothing a step, and get a shorter one
# for their flights: what rests gets the step of many (docs/physics.md, 3)

SMOOTH_UP_TO = 8  # bodies without contacts: of more, a step that does not follow the pulls misses encounters, and
# there order four gains less than it costs

PAIRS_UP_TO = 100  # bodies whose pairs are looked at one by one for the step; beyond, that costs as much as the pulls
PAIR_FRACTION = 0.01  # of the shortest time of a pair: 890 steps in a circular orbit (docs/physics.md, 3)
PULL_FRACTION = 0.02  # of the time that the largest acceleration tells of: of two equal bodies it is twice the pair's
SMOOTHING = 0.2  # weight of the new step in the average, where contacts come and go

LATE_CFL = 0.5  # of its radius a body may cross in a step, where impacts wait for the step's end
FREE_CFL = 1.0  # likewise, where they do not wait and nothing pulls: shorter steps only cost more (docs/trade.md)

TREE_FROM = 5000  # bodies, for "auto": here a tree takes a half to a third of the time of a direct sum


def gravity_method(scene: Scene) -> Literal["direct", "tree", "none"]:
    """Decide how the pull is summed.

    Both take as long for 800 bodies in a uniform ball and for 2000 in a cluster. "auto" waits for `TREE_FROM`: up to
    there a tree saves milliseconds at most, and the direct sum keeps momentum to round-off.
    """
    method = scene.gravity.method
    if method == "none" or not (pulls.gravity(scene).modelled or "gravity" in forced_parts(scene)):
        return "none"
    if method == "auto":
        return "direct" if scene.count < TREE_FROM else "tree"
    return method


def timing(scene: Scene) -> Literal["end-of-step", "time-of-impact"]:
    """Decide when impacts are resolved: at their own moments, unless the bodies' own gravity presses them together.

    Without a load flight is free, and a run is exact to rounding with steps many times as long. Under a uniform field
    a heap that falls costs a sixth more and overlaps by a sixth as much. Under self-gravity an impact at its own moment
    costs more than it gains (docs/trade.md).
    """
    return "end-of-step" if why_late(scene) else "time-of-impact"


def why_late(scene: Scene) -> str:
    """Say why impacts wait for the end of the step; empty if they do not."""
    asked, chosen = scene.contact.timing, integrator(scene)
    if asked != "auto":
        return f'contact.timing = "{asked}"' if asked == "end-of-step" else ""
    if not contacts.contact(scene).modelled:
        return "no contact is possible"
    if (force := contacts.load(scene)) and not contacts.field_presses(scene):
        whose = "the bodies' own gravity" if force == GRAVITY.short_name else f"the {force}"
        return f"{whose} presses contacts together"
    return "" if chosen.drifts_once else f"a step of {chosen.name} is more than one drift"


def integrator(scene: Scene) -> Integrator:
    """Decide how the motion is integrated: order four where nothing in it is sudden (docs/trade.md)."""
    if scene.time.integrator != AUTO:
        return INTEGRATORS[scene.time.integrator]
    return INTEGRATORS["yoshida4" if _is_smooth(scene) else "leapfrog"]


def _is_smooth(scene: Scene) -> bool:
    if not pulls.gravity(scene).modelled or contacts.contact(scene).modelled or pulls.damping(scene):
        return False
    resolved = scene.time.fixed_dt is None and pull_fraction(scene) is not None  # every encounter, by its own step
    return scene.count <= (PAIRS_UP_TO if resolved else SMOOTH_UP_TO)


def target_dx(scene: Scene) -> float | None:
    """Return the farthest that the largest acceleration may move a body in a step, in metres; None for no limit.

    A fall from rest through the smallest radius r takes √(2 r/a); a part s of that time is s² r of the way. Where
    nothing can touch, radii have no say.
    """
    if scene.time.target_dx != "auto":
        return scene.time.target_dx
    if not contacts.contact(scene).modelled:
        return None
    return auto_step(scene) ** 2 * smallest_radius(scene)


def held_dx(scene: Scene) -> float | None:
    """Return ``target_dx`` in metres for bodies that lasting contacts hold; None where it is the same as for others.

    A short step makes the flights between bounces exact. What rests does not fly: the pull on it is balanced, and a
    step of a tenth of a fall, as many bodies get, holds it.
    """
    if scene.time.target_dx != "auto" or scene.count >= MANY or scene.contact.solver != "lasting":
        return None
    contact = contacts.contact(scene)
    if not contacts.resting(scene, contact).modelled:
        return None
    return (STEP_PER_BODY * MANY) ** 2 * smallest_radius(scene)


def cfl(scene: Scene) -> float | None:
    """Return the part of its own radius that a body may cross in a step; None for no limit."""
    if scene.time.cfl != "auto":
        return scene.time.cfl
    if not contacts.contact(scene).modelled:
        return None
    return FREE_CFL if timing(scene) == "time-of-impact" and not contacts.load(scene) else LATE_CFL


def pull_fraction(scene: Scene) -> float | None:
    """Return the step as a part of the shortest time in which pulls change the motion; None for no limit.

    Unless it is given, it stands in for the limits by radius where nothing can touch, but not for a ``target_dx``.
    """
    if not pulls.gravity(scene).modelled:
        return None
    if scene.time.pull_fraction != "auto":
        return scene.time.pull_fraction
    if contacts.contact(scene).modelled or scene.time.target_dx != "auto":
        return None
    return PAIR_FRACTION if scene.count <= PAIRS_UP_TO else PULL_FRACTION


def smoothing(scene: Scene) -> float:
    """Return the weight of the new step in the moving average.

    Contacts come and go, and the step that they allow jumps. That of the pulls alone is smooth: an average would lag
    behind it, so that an orbit would be stepped differently on its way in and out, and drift.
    """
    if scene.time.smoothing != "auto":
        return scene.time.smoothing
    by_pull_alone = cfl(scene) is None and target_dx(scene) is None and pull_fraction(scene) is not None
    return 1.0 if by_pull_alone else SMOOTHING


def smallest_radius(scene: Scene) -> float:
    """Return the smallest radius of a body in metres."""
    return min([body.radius for body in scene.body] + [group.radius.min for group in scene.group])


def auto_step(scene: Scene) -> float:
    """Return an "auto" step as a fraction of the time of a fall from rest through the smallest radius."""
    return STEP_PER_BODY * min(scene.count, MANY)


def frame_interval(scene: Scene) -> float:
    """Return the simulated time between recorded frames in seconds; 0 records every step."""
    if scene.record.every == "step":
        return 0.0
    return auto_interval(scene) if scene.record.every == "auto" else scene.record.every


def auto_interval(scene: Scene) -> float:
    """Return the simulated time in seconds between the frames of a recording that chooses them itself."""
    affordable = AUTO_BYTES // (BYTES_PER_BODY_AND_FRAME * scene.count)
    return scene.time.duration / min(FRAMES, max(FEWEST_FRAMES, affordable))
