"""Which parts of the model a scene needs, and why. Decided from the scene alone.

A part that is not required costs no time, no memory and no bytes in the recording, and leaving it out never changes
the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from carom.scene.schema import Scene

FRAMES = 600  # of an "auto" recording: more than a person scrubs through, few enough to open at once
FEWEST_FRAMES = 50
AUTO_BYTES = 300_000_000  # an "auto" recording of many bodies gets fewer frames to stay below
BYTES_PER_BODY_AND_FRAME = 60  # centre, quaternion, and about one arrow or edge

MANY = 100  # bodies, from which on an "auto" step is a tenth of the fall from rest through the smallest radius
STEP_PER_BODY = 1e-3  # of that fall; fewer bodies cost next to nothing a step, and get a shorter one

SMOOTH_UP_TO = 8  # bodies without contacts: of more, encounters decide, and there order four gains less than it costs
SMOOTH_STEP = 2.0  # times the step that leapfrog gets: with it Yoshida's method takes 1.5 times the force sums and errs
# by 0.0007 (3 bodies) to 0.42 (8) of what leapfrog does; leapfrog for that price, by 0.44 (benchmarks/integrators.py)

TREE_FROM = 5000  # bodies, for "auto": here a tree takes a half to a third of the time of a direct sum


@dataclass(frozen=True)
class Part:
    """One part of the model: its name, whether it is modelled, and the reason."""

    name: str
    modelled: bool
    why: str


@dataclass(frozen=True)
class Requirements:
    """The parts of the model that a scene needs."""

    gravity: Part
    field: Part
    contact: Part
    search: Part
    friction: Part
    torque: Part
    spin: Part
    integrator: Part
    adaptive_step: Part
    warm_up: Part

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts, in the order in which a step uses them."""
        return tuple(vars(self).values())


def require(scene: Scene) -> Requirements:
    """Decide what a scene needs."""
    gravity, contact = _gravity(scene), _contact(scene)
    friction = _friction(scene, contact)
    torque = Part(
        "torque",
        friction.modelled,
        "friction turns bodies" if friction.modelled else "nothing turns a body: the normal force acts on the centre",
    )
    return Requirements(
        gravity=gravity,
        field=_field(scene),
        contact=contact,
        search=_search(scene, contact),
        friction=friction,
        torque=torque,
        spin=_spin(scene, friction),
        integrator=_integrator(scene),
        adaptive_step=_adaptive_step(scene),
        warm_up=_warm_up(scene),
    )


def _gravity(scene: Scene) -> Part:
    name, n, method = "gravity", scene.count, gravity_method(scene)
    if scene.gravity.method == "none":
        return Part(name, False, 'gravity.method = "none"')
    if scene.gravity.constant == 0:
        return Part(name, False, "gravity.constant = 0")
    if n == 1:
        return Part(name, False, "one body pulls nothing else")
    how = {
        "direct": f"direct sum over {n} bodies",
        "tree": f"tree over {n} bodies, opening angle {scene.gravity.opening_angle:g}"
        + ("" if scene.gravity.quadrupoles else ", without quadrupoles"),
    }[method]
    if scene.gravity.method == "auto":
        how += f" ({'fewer than' if n < TREE_FROM else 'at least'} {TREE_FROM})"
    return Part(name, True, f"{how}, with the potential where an energy is due")


def gravity_method(scene: Scene) -> Literal["direct", "tree", "none"]:
    """Decide how the pull is summed.

    Both take as long for 800 bodies in a uniform ball and for 2000 in a cluster. "auto" waits for `TREE_FROM`: up to
    there a tree saves milliseconds at most, and the direct sum keeps momentum to round-off.
    """
    method = scene.gravity.method
    if method == "none" or scene.gravity.constant == 0 or scene.count == 1:
        return "none"
    if method == "auto":
        return "direct" if scene.count < TREE_FROM else "tree"
    return method


def _field(scene: Scene) -> Part:
    if any(scene.gravity.uniform):
        return Part("uniform field", True, f"gravity.uniform = {list(scene.gravity.uniform)} m/s²")
    return Part("uniform field", False, "gravity.uniform is zero")


def _contact(scene: Scene) -> Part:
    name = "contact"
    if not scene.contact.enabled:
        return Part(name, False, "contact.enabled = false")
    solids = len(scene.plane) + (6 if scene.domain.boundary == "walls" else 0)
    if scene.count == 1 and solids == 0:
        return Part(name, False, "one body has nothing to touch")
    if not _gravity(scene).modelled and not _moves_relatively(scene):
        return Part(name, False, "all bodies move alike and nothing pulls: their distances never change")
    if solids:
        return Part(name, True, f"{scene.count} bodies and {solids} planes may meet")
    return Part(name, True, f"{scene.count} bodies may meet")


def _moves_relatively(scene: Scene) -> bool:
    """Tell whether any two bodies start with different velocities (or overlapped, and so will be pushed).

    Planes, walls and fixed bodies stand still, and the uniform field does not pull them.
    """
    velocities = {body.velocity for body in scene.body} | {group.velocity.mean for group in scene.group}
    if scene.anchored:
        velocities.add((0.0, 0.0, 0.0))
        if _field(scene).modelled:
            return True
    stirred = any(group.velocity.dispersion > 0 or any(group.bulk_rotation) for group in scene.group)
    return len(velocities) > 1 or stirred or scene.contact.allow_overlap


def _search(scene: Scene, contact: Part) -> Part:
    name = "broad phase"
    if not contact.modelled:
        return Part(name, False, "no contact is possible")
    how = "k-d trees" if scene.contact.search == "k-d-tree" else "hashed grids"
    return Part(name, True, f"{how}, one for each octave of radius")


def _friction(scene: Scene, contact: Part) -> Part:
    name = "friction"
    if not contact.modelled:
        return Part(name, False, "no contact is possible")
    if scene.contact.static_friction == 0 and all(plane.law(scene.contact)[1] == 0 for plane in scene.plane):
        return Part(name, False, "both coefficients are 0")
    return Part(name, True, f"μs = {scene.contact.static_friction:g}, μk = {scene.contact.kinetic_friction:g}")


def _spin(scene: Scene, friction: Part) -> Part:
    name = "spin and orientation"
    if friction.modelled:
        return Part(name, True, "friction turns bodies")
    spinning = any(any(body.angular_velocity) for body in scene.body) or any(
        group.spin.dispersion > 0 or any(group.bulk_rotation) for group in scene.group
    )
    if spinning:
        return Part(name, True, "bodies spin at the start")
    return Part(name, False, "no friction, and nothing spins at the start")


def integrator(scene: Scene) -> Literal["euler", "leapfrog", "leapfrog-dkd", "yoshida4"]:
    """Decide how the motion is integrated: order four where nothing in it is sudden (docs/trade.md)."""
    if scene.time.integrator != "auto":
        return scene.time.integrator
    return "yoshida4" if _is_smooth(scene) else "leapfrog"


def _is_smooth(scene: Scene) -> bool:
    return _gravity(scene).modelled and not _contact(scene).modelled and scene.count <= SMOOTH_UP_TO


def _integrator(scene: Scene) -> Part:
    name, chosen = "integrator", integrator(scene)
    if scene.time.integrator != "auto":
        return Part(name, True, f'time.integrator = "{chosen}"')
    if chosen == "yoshida4":
        return Part(name, True, f"yoshida4: {scene.count} bodies pull each other, and no contact is modelled")
    if _contact(scene).modelled:
        why = "contacts are found at the end of a step, whatever the order"
    elif _gravity(scene).modelled:
        why = f"more than {SMOOTH_UP_TO} bodies, whose encounters are sudden"
    else:
        why = "exact without a pull between bodies"
    return Part(name, True, f"leapfrog: {why}")


def _adaptive_step(scene: Scene) -> Part:
    name = "adaptive step"
    if scene.time.fixed_dt is not None:
        return Part(name, False, "time.fixed_dt")
    why = f"target_dx = {target_dx(scene):.3g} m"
    if scene.time.target_dx != "auto":
        return Part(name, True, why)
    share = _auto_step(scene)
    return Part(name, True, f"{why}: for {scene.count} bodies, {share:g} of a fall through the smallest radius")


def _warm_up(scene: Scene) -> Part:
    if scene.time.fixed_dt is not None:
        return Part("warm-up", False, "time.fixed_dt: no step has to be found")
    return Part("warm-up", True, "the first adaptive step needs accelerations")


def target_dx(scene: Scene) -> float:
    """Return the farthest that the largest acceleration may move a body in a step, in metres.

    A fall from rest through the smallest radius r takes √(2 r/a); a part s of that time is s² r of the way.
    """
    if scene.time.target_dx != "auto":
        return scene.time.target_dx
    radii = [body.radius for body in scene.body] + [group.radius.min for group in scene.group]
    return _auto_step(scene) ** 2 * min(radii)


def _auto_step(scene: Scene) -> float:
    longer = SMOOTH_STEP if _is_smooth(scene) and integrator(scene) == "yoshida4" else 1.0
    return longer * STEP_PER_BODY * min(scene.count, MANY)


def frame_interval(scene: Scene) -> float:
    """Return the simulated time between recorded frames in seconds; 0 records every step."""
    if scene.record.every == "step":
        return 0.0
    if scene.record.every == "auto":
        affordable = AUTO_BYTES // (BYTES_PER_BODY_AND_FRAME * scene.count)
        return scene.time.duration / min(FRAMES, max(FEWEST_FRAMES, affordable))
    return scene.record.every
