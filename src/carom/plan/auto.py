"""The values of "auto" in a scene: gravity method, integrator, timing, limits of the step, frame interval."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

from carom.plan import interactions
from carom.plan.hierarchy import FEWEST_ORBITS, MOST_APART, far_apart, orbits_often
from carom.plan.interactions import forced_parts
from carom.plan.once_a_scene import once_a_scene
from carom.scene.integrators import AUTO, INTEGRATORS, Integrator, integrator_called
from carom.scene.load import Scene
from carom.scene.matter import body_mass, made_of, mean_mass

FRAMES = 600  # frames of an "auto" recording: enough to scrub through smoothly, few enough to open at once
FEWEST_FRAMES = 50
AUTO_BYTES = 300_000_000  # largest "auto" recording: with many bodies, it gets fewer frames
BYTES_PER_BODY_AND_FRAME = 60  # bytes for a centre, a quaternion, and about one arrow or edge

MAX_DT = 1.0  # s, the longest step of kicks and drifts, as in the reference engine
# a run that would take more steps of `MAX_DT` has longer steps: 1 s is no time scale of orbits, and a year would take
# 3 × 10⁷ steps
FEWEST_STEPS = 1e6
# largest strain of a packing in a step; a strain of 0.015 halves the stress at a packing fraction of 0.54
STRAIN_PER_STEP = 1e-3
# smallest number of steps per oscillation of a wall: contacts are held against the wall's mean velocity in a step
STEPS_PER_OSCILLATION = 100

# number of bodies up to which "auto" steps grow with the number; with more bodies, they are a tenth of the time of a
# fall through the smallest radius
STEP_GROWS_UP_TO = 100
# fraction of this fall time for each body: steps of few bodies are cheap, and may be shorter, for accurate flights;
# bodies held by contacts always have the step for `STEP_GROWS_UP_TO` bodies (docs/physics.md, 3)
STEP_PER_BODY = 1e-3

# largest number of bodies without contacts whose motion counts as smooth; with more, "auto" steps miss encounters,
# and fourth order costs more than it gains
SMOOTH_UP_TO = 8

# largest number of bodies for which the step rule examines each pair; with more bodies, that costs as much as gravity
PAIRS_UP_TO = 100
PAIR_FRACTION = 0.01  # step over the shortest time scale of a pair: 890 steps in a circular orbit (docs/physics.md, 3)
PULL_FRACTION = 0.02  # step over the time scale of the largest acceleration; a pair of equal bodies has half that scale
SMOOTHING = 0.2  # weight of the new step in the moving average, if contacts form and break

# largest motion of a body in a step, divided by its radius (docs/trade.md)
LATE_CFL = 0.5  # largest motion if impacts are resolved at the end of the step
FREE_CFL = 1.0  # largest motion if times of impact are exact and no forces act, where shorter steps gain nothing


# largest number of bodies for gauss-radau15 if they orbit far apart without contacts; for 300 to 900 bodies, it takes
# 0.6 times as long as leapfrog on circles, one to three times as long with encounters, at a thousandth of the error or
# less
ORBITS_UP_TO = 1000

# largest number of bouncing bodies; gauss-radau15 restarts all bodies at each impact (docs/trade.md)
BOUNCES_UP_TO = 200

TREES = ("tree", "fast-multipole")  # methods that sum over boxes of bodies, with an error set by the opening angle
# smallest number of bodies for which "auto" chooses a tree, which takes a third to a half as long as a direct sum
TREE_FROM = 5000

HELD_PART = 0.01  # largest motion of a held body in a step, in radii: 600 steps per revolution of a rolling pair
WIDEST_HELD_PART = 0.1
WIDEST_HELD = 3.0  # largest step of held bodies, in multiples of their usual step
WIDEST_FALL = 0.5  # largest step, as a fraction of the time of a fall through the smallest radius
WIDEST_PULL_FRACTION = 0.1  # largest step over the shortest time scale of a pair: 90 steps in a circular orbit


def gravity_method(scene: Scene) -> Literal["direct", "tree", "fast-multipole", "none"]:
    """Decide how gravity is summed.

    A direct sum and a tree take equally long for 800 bodies in a uniform ball, and for 2000 bodies in a cluster. "auto"
    switches at `TREE_FROM`. Below that number, a tree saves milliseconds at most, and the direct sum conserves momentum
    to round-off.
    """
    method = scene.gravity.method
    if method == "none" or not (interactions.gravity(scene).modelled or "gravity" in forced_parts(scene)):
        return "none"
    if method == "auto":
        return "direct" if scene.count < TREE_FROM else "tree"
    return method


def uses_tree(scene: Scene) -> bool:
    """Return whether gravity is summed over boxes, with an error that the opening angle sets."""
    return gravity_method(scene) in TREES


def timing(scene: Scene) -> Literal["end-of-step", "time-of-impact"]:
    """Decide when impacts are resolved: at their own times, wherever the integrator can locate them.

    An impact at the end of a step has the direction, friction and spin of overlapping spheres. This error is the same
    with and without forces that press the bodies together, so no force changes the timing (docs/trade.md).
    """
    return "end-of-step" if why_late(scene) else "time-of-impact"


def why_late(scene: Scene) -> str:
    """Return the reason why impacts are resolved at the end of the step; empty if they are not."""
    asked, chosen = scene.contact.timing, integrator(scene)
    if asked != "auto":
        return f'contact.timing = "{asked}"' if asked == "end-of-step" else ""
    if not interactions.contact(scene).modelled:
        return "no contact is possible"
    if interactions.flow_presses(scene):
        return f"domain.shear with a packing fraction above {interactions.DENSE:g}: contacts last"
    # with an accuracy, `limits` refuses any other integrator
    if chosen.locates_impacts or scene.time.accuracy is not None:
        return ""
    return f"a step of {chosen.name} is more than one drift"


def largest_speed(scene: Scene) -> float:
    """Return the largest relative speed (m/s) of two bodies at the start; 0 if all have the same velocity."""
    velocities = [body.velocity for body in scene.body] + [group.velocity.mean for group in scene.group]
    for columns in scene.data:
        velocities += [tuple(columns.velocity.min(axis=0)), tuple(columns.velocity.max(axis=0))]
    size = math.hypot(*(max(along) - min(along) for along in zip(*velocities, strict=True)))
    return max([size, *(group.velocity.dispersion for group in scene.group)])


def most_steps(scene: Scene, first: float) -> float:
    """Return the largest number of steps of a run, given its first step (s) and the fastest conceivable contacts.

    Bodies that fall onto another body reach its escape speed, v = √(2 G m/r). The smallest body that slides or rolls
    there may then move in a step by `cfl` times its own radius.
    """
    duration, fixed, limit = scene.time.duration, scene.time.fixed_dt, cfl(scene)
    if fixed is not None or limit is None:
        return duration / (fixed or first)
    depths = [body_mass(made_of(scene, body)) / body.radius for body in scene.body]
    depths += [mean_mass(made_of(scene, group)) / group.radius.min for group in scene.group]
    depths += [float((columns.mass / columns.radius).max()) for columns in scene.data]
    pull = 2.0 * scene.gravity.constant * max(depths) if interactions.gravity(scene).modelled else 0.0
    speed = math.hypot(largest_speed(scene), math.sqrt(pull))
    return duration * max(1.0 / first, speed / (limit * smallest_radius(scene)))


@once_a_scene
def integrator(scene: Scene) -> Integrator:
    """Choose the integrator: one of high order where the motion is smooth (docs/trade.md)."""
    if scene.time.integrator != AUTO:
        return integrator_called(scene.time.integrator)
    if scene.time.accuracy is not None:
        promised = scene.promise.integrator if scene.promise else None
        return INTEGRATORS[promised or _accurate(scene)]
    if not _is_smooth(scene):
        return INTEGRATORS["gauss-radau15" if _meets_seldom(scene) or _orbits_apart(scene) else "leapfrog"]
    if _leaves_step_free(scene) and not scene.forces.given and orbits_often(scene) >= FEWEST_ORBITS:
        return INTEGRATORS["wisdom-holman"]
    return INTEGRATORS["gauss-radau15" if _leaves_step_free(scene) else "yoshida4"]


def _meets_seldom(scene: Scene) -> bool:
    """Return whether encounters are rare, as for planets, moons and comets.

    With leapfrog's steps of at most a second, eighty years of a comet took hours to compute. Gauss–Radau integration
    takes a second.
    """
    if not (
        interactions.contact(scene).modelled and interactions.gravity(scene).modelled and _bounces_on_curves(scene)
    ):
        return False
    alone = scene.domain.boundary == "open" and not (scene.plane or scene.wall) and not interactions.pushing(scene)
    as_usual = scene.contact.timing == "auto" and scene.contact.sleep is None
    drifts = interactions.moves_relatively(scene)  # bodies that start at rest fall towards each other
    return alone and as_usual and drifts and _leaves_step_free(scene) and far_apart(scene)


def _orbits_apart(scene: Scene) -> bool:
    """Return whether many bodies that cannot touch orbit a dominant one far from each other."""
    if interactions.contact(scene).modelled or interactions.damping(scene) or not _leaves_step_free(scene):
        return False
    many = MOST_APART < scene.count <= ORBITS_UP_TO
    return many and interactions.gravity(scene).modelled and not scene.forces.given and far_apart(scene)


def _accurate(scene: Scene) -> str:
    """Return the integrator with the lowest cost for an accuracy, before a look-ahead may find a cheaper one."""
    if interactions.contact(scene).modelled:
        # only leapfrog finds impacts on walls
        return "gauss-radau15" if _bounces_on_curves(scene) and not scene.wall else "leapfrog"
    if interactions.damping(scene) or not interactions.differing(scene) or scene.domain.is_periodic:
        return "leapfrog"
    by_pairs = scene.gravity.method not in TREES and scene.count < TREE_FROM
    return "gauss-radau15" if by_pairs else "yoshida4"


def _bounces_on_curves(scene: Scene) -> bool:
    """Return whether a few colliding bodies move on curved paths, so that a high order between impacts pays."""
    bent = interactions.load(scene) != "" and not interactions.damping(scene)
    open_space = not scene.domain.is_periodic and not scene.contact.allow_overlap
    return bent and open_space and scene.gravity.method not in TREES and scene.count <= BOUNCES_UP_TO


def holding(scene: Scene) -> Scene:
    """Return the scene with an integrator that computes resting contacts, not only impacts."""
    time = scene.time.model_copy(update={"integrator": "leapfrog"})
    contact = scene.contact.model_copy(update={"timing": "time-of-impact"})
    return scene.model_copy(update={"time": time, "contact": contact})


def _leaves_step_free(scene: Scene) -> bool:
    """Return whether an integrator may choose its steps by its own error: in open space, if no key sets a step."""
    rule = scene.time
    if scene.domain.is_periodic:
        return False
    keys = (rule.target_dx, rule.cfl, rule.pull_fraction, rule.smoothing)
    return rule.fixed_dt is None and all(value == "auto" for value in keys) and scene.gravity.method not in TREES


def _is_smooth(scene: Scene) -> bool:
    if not interactions.differing(scene) or interactions.contact(scene).modelled or interactions.damping(scene):
        return False
    # whether the step resolves each encounter
    resolved = scene.time.fixed_dt is None and pull_fraction(scene) is not None
    return scene.count <= (PAIRS_UP_TO if resolved else SMOOTH_UP_TO)


def largest_step(scene: Scene, duration: float | None = None) -> float:
    """Return the largest step (s); infinite if the integrator sets its steps by its error or by the orbits.

    With a limit of 1 s, two years of the Earth's orbit would take 63 million Gauss–Radau steps instead of 79 steps.
    The default of ``duration`` (s) is the scene's duration.
    """
    if scene.time.max_dt != "auto":
        return scene.time.max_dt
    if integrator(scene).controls_error:
        return math.inf
    if (shear := scene.domain.shear) is not None and interactions.flow_presses(scene) and shear.rate != 0.0:
        return min(MAX_DT, STRAIN_PER_STEP / abs(shear.rate))
    frequencies = [solid.motion.frequency for solid in scene.translating if solid.motion and solid.motion.frequency]
    longest = max(MAX_DT, (scene.time.duration if duration is None else duration) / FEWEST_STEPS)
    return min([longest, *(1.0 / (STEPS_PER_OSCILLATION * frequency) for frequency in frequencies)])


def target_dx(scene: Scene) -> float | None:
    """Return the largest distance (m) that an acceleration may move a body from rest in a step; None for no limit.

    A fall from rest through the smallest radius r takes √(2 r/a). In a fraction s of that time, the body falls by s² r.
    Without contacts, radii do not matter, and with gravity the shortest time scale of a pair limits the step.
    """
    if scene.time.target_dx != "auto":
        return scene.time.target_dx
    if not interactions.contact(scene).modelled and (
        interactions.gravity(scene).modelled or not interactions.differing(scene)
    ):
        return None
    return auto_step(scene) ** 2 * smallest_radius(scene)


def held_dx(scene: Scene) -> float | None:
    """Return ``target_dx`` (m) for bodies held by lasting contacts; None if it is the same as for other bodies.

    Short steps make flights between bounces accurate. Forces on a held body are balanced, so it does not fly. The step
    for many bodies, a tenth of the time of a fall, is short enough for a single held body.
    """
    if scene.time.target_dx != "auto" or scene.count >= STEP_GROWS_UP_TO or scene.contact.solver != "lasting":
        return None
    contact = interactions.contact(scene)
    if not interactions.resting(scene, contact).modelled:
        return None
    return (STEP_PER_BODY * STEP_GROWS_UP_TO) ** 2 * smallest_radius(scene)


def cfl(scene: Scene) -> float | None:
    """Return the fraction of its own radius that a body may move in a step; None for no limit."""
    if scene.time.cfl != "auto":
        return scene.time.cfl
    if not interactions.contact(scene).modelled:
        return None
    return FREE_CFL if timing(scene) == "time-of-impact" and not interactions.load(scene) else LATE_CFL


def pull_fraction(scene: Scene) -> float | None:
    """Return the step as a fraction of the shortest time scale of the forces; None for no limit.

    By default, this limit replaces the limits that depend on radii in scenes without contacts, unless the scene sets
    ``target_dx``.
    """
    if not interactions.gravity(scene).modelled:
        return None
    if scene.time.pull_fraction != "auto":
        return scene.time.pull_fraction
    if interactions.contact(scene).modelled or scene.time.target_dx != "auto":
        return None
    return PAIR_FRACTION if scene.count <= PAIRS_UP_TO else PULL_FRACTION


def smoothing(scene: Scene) -> float:
    """Return the weight of the new step in the moving average.

    The step allowed by contacts jumps, so it is averaged. The step allowed by forces alone is smooth, and an average
    would lag behind it. An orbit would then have different steps on its way in and out, and its energy would drift.
    """
    if scene.time.smoothing != "auto":
        return scene.time.smoothing
    by_pull_alone = cfl(scene) is None and target_dx(scene) is None and pull_fraction(scene) is not None
    return 1.0 if by_pull_alone else SMOOTHING


def smallest_radius(scene: Scene) -> float:
    """Return the smallest radius of a body in metres."""
    given = [body.radius for body in scene.body] + [columns.radii[0] for columns in scene.data]
    return min(given + [group.radius.min for group in scene.group])


def auto_step(scene: Scene) -> float:
    """Return an "auto" step as a fraction of the time in which a body falls from rest through the smallest radius."""
    return STEP_PER_BODY * min(scene.count, STEP_GROWS_UP_TO)


def frame_interval(scene: Scene) -> float:
    """Return the simulated time (s) between recorded frames; 0 records every step."""
    if scene.record.every == "step":
        return 0.0
    return auto_interval(scene, scene.time.duration) if scene.record.every == "auto" else scene.record.every


def auto_interval(scene: Scene, duration: float) -> float:
    """Return the automatic time (s) between frames, given the duration of a recording (s)."""
    affordable = AUTO_BYTES // (BYTES_PER_BODY_AND_FRAME * scene.count)
    return duration / min(FRAMES, max(FEWEST_FRAMES, affordable))


@dataclass(frozen=True, slots=True)
class StepLimits:
    """The limits of the step, by their keys; None in place of a limit that does not apply."""

    max_dt: float  # s; infinite for no limit
    cfl: float | None
    target_dx: float | None  # m
    # m, used in place of ``target_dx`` for bodies held by lasting contacts; None if ``target_dx`` applies
    held_dx: float | None = None
    held_part: float = HELD_PART  # largest motion of a held body in a step, divided by its radius
    pull_fraction: float | None = None
    smoothing: float = 1.0  # weight of the new step in the moving average


def step_limits(scene: Scene) -> StepLimits:
    """Return the limits of a scene."""
    if scene.promise is not None:
        return accurate_limits(scene, scene.promise.refinement, scene.promise.until)
    return StepLimits(
        max_dt=largest_step(scene),
        cfl=cfl(scene),
        target_dx=target_dx(scene),
        held_dx=held_dx(scene),
        pull_fraction=pull_fraction(scene),
        smoothing=smoothing(scene),
    )


def accurate_limits(scene: Scene, refinement: float, until: float) -> StepLimits:
    """Return step limits for runs with exact times of impact: the longest useful limits, divided by a factor.

    All limits shrink by the same factor, so that runs with different refinements differ wherever the step matters. No
    step is longer than the automatic interval of frames in a recording of ``until`` seconds, the span of the
    look-ahead. A longer or resumed run keeps the same limit.
    """
    touches = cfl(scene) is not None
    return StepLimits(
        max_dt=min(largest_step(scene, until), auto_interval(scene, until)) / refinement,
        cfl=FREE_CFL / refinement if touches else None,
        target_dx=(WIDEST_FALL / refinement) ** 2 * smallest_radius(scene) if touches else None,
        pull_fraction=None if pull_fraction(scene) is None else WIDEST_PULL_FRACTION / refinement,
    )


def wider_limits(scene: Scene, stride: float) -> StepLimits:
    """Return limits for steps up to ``stride`` times as long that still detect contacts and resolve orbits."""
    if scene.promise is not None:
        return accurate_limits(scene, scene.promise.refinement / stride, scene.promise.until)

    def wider(limit: float | None, widest: float) -> float | None:
        return None if limit is None else min(stride * limit, max(limit, widest))

    reach, fall = target_dx(scene), STEP_PER_BODY * STEP_GROWS_UP_TO * math.sqrt(smallest_radius(scene))
    rest = held_dx(scene)
    root = wider(None if reach is None else math.sqrt(reach), fall)
    return StepLimits(
        max_dt=stride * largest_step(scene),
        cfl=wider(cfl(scene), FREE_CFL),
        target_dx=None if root is None else root * root,
        held_dx=None if rest is None else min(stride, WIDEST_HELD) ** 2 * rest,
        held_part=min(stride * HELD_PART, WIDEST_HELD_PART),
        pull_fraction=wider(pull_fraction(scene), WIDEST_PULL_FRACTION),
    )


def shorter_steps(scene: Scene, stride: float) -> tuple[StepLimits, Scene]:
    """Return step limits multiplied by a ``stride`` below 1, and the scene with its fixed step multiplied as well.

    No other setting changes, so the method is the same.
    """
    time, limits = scene.time, step_limits(scene)

    def shorter(limit: float | None, factor: float = stride) -> float | None:
        return None if limit is None else factor * limit

    if time.fixed_dt is not None:
        scene = scene.model_copy(update={"time": time.model_copy(update={"fixed_dt": stride * time.fixed_dt})})
    return replace(
        limits,
        max_dt=stride * limits.max_dt,
        cfl=shorter(limits.cfl),
        target_dx=shorter(limits.target_dx, stride * stride),  # `dx` = ½ a dt² is quadratic in the step
        held_dx=shorter(limits.held_dx, stride * stride),
        held_part=stride * limits.held_part,
        pull_fraction=shorter(limits.pull_fraction),
    ), scene
