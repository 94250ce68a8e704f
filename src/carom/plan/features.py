"""Which parts of the model a scene needs, and why. Decided from the scene alone.

A part that is not required costs no time, no memory and no bytes in the recording, and leaving it out never changes
the result.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from carom.plan import contacts, pulls
from carom.scene.error import SceneError
from carom.scene.forces import FORCES, GRAVITY, UNIFORM_FIELD
from carom.scene.integrators import AUTO, INTEGRATORS, Integrator
from carom.scene.parts import PARTS, Part
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


@dataclass(frozen=True)
class Requirements:
    """The parts of the model that a scene needs, or is forced to have."""

    warm_up: Part
    adaptive_step: Part
    integrator: Part
    spin: Part
    orientation: Part
    contact: Part
    broad_phase: Part
    narrow_phase: Part
    impact_time: Part
    colouring: Part
    stabilisation: Part
    forces: Mapping[str, Part]  # by their names
    tree: Part
    potential: Part
    resting: Part
    restitution: Part
    friction: Part
    torque: Part
    energy: Part

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts, in the order in which a step uses them."""
        found = _by_name(self)
        return tuple(found[name] for name in PARTS)

    @property
    def gravity(self) -> Part:
        """Whether bodies pull each other."""
        return self.forces[GRAVITY.name]

    @property
    def field(self) -> Part:
        """Whether a uniform field pulls."""
        return self.forces[UNIFORM_FIELD.name]

    @property
    def pulls(self) -> bool:
        """Whether anything is accelerated between contacts."""
        return any(part.modelled for part in self.forces.values())


# What a part cannot be without. What follows from a part, such as torques from friction, is decided as for any other.
_NEEDS = {
    "potential": ("gravity",),
    "tree": ("gravity",),
    "broad-phase": ("contact",),
    "narrow-phase": ("contact",),
    "time-of-impact": ("contact",),
    "colouring": ("contact",),
    "stabilisation": ("contact",),
    "resting-contacts": ("contact",),
    "restitution": ("contact",),
    "friction": ("contact",),
    "torque": ("contact", "spin"),
    "orientation": ("spin",),
}


def require(scene: Scene) -> Requirements:
    """Decide what a scene needs, and switch the parts in ``model.force`` on against the decision.

    Raises
    ------
    SceneError
        If a part cannot be forced on.
    """
    forced, required = _forced(scene), _decide(scene, {})
    if not forced:
        return required
    before = _by_name(required)

    def explained(part: Part) -> Part:
        if part.name not in forced or before[part.name].modelled:
            return part
        by = "" if forced[part.name] == part.name else f" by {forced[part.name]}"
        return Part(part.name, True, f"forced{by}; otherwise not: {before[part.name].why}")

    decided: dict[str, Any] = vars(_decide(scene, forced))
    forces = {name: explained(part) for name, part in decided["forces"].items()}
    others = {key: explained(part) for key, part in decided.items() if key != "forces"}
    return Requirements(**others, forces=forces)


def _by_name(needs: Requirements) -> dict[str, Part]:
    """Return all parts by their names."""
    single = [found for found in vars(needs).values() if isinstance(found, Part)]
    return {part.name: part for part in (*single, *needs.forces.values())}


def _decide(scene: Scene, forced: Mapping[str, str]) -> Requirements:
    """Decide part after part; what follows from a part that is forced on is decided as if it were required."""

    def decide(part: Part) -> Part:
        if part.modelled or part.name not in forced:
            return part
        contradiction = _contradiction(scene, part.name)
        if contradiction:
            raise SceneError(f"model.force: {forced[part.name]} cannot be forced on: {contradiction}")
        return Part(part.name, True, part.why)

    forces = {kind.name: decide(pulls.part(kind, scene)) for kind in FORCES}
    contact = decide(contacts.contact(scene))
    friction = decide(contacts.friction(scene, contact))
    torque = decide(contacts.torque(friction))
    return Requirements(
        warm_up=decide(_warm_up(scene)),
        adaptive_step=decide(_adaptive_step(scene)),
        integrator=_integrator(scene),
        spin=decide(_spin(scene, friction)),
        orientation=decide(_orientation(scene, friction)),
        contact=contact,
        broad_phase=decide(contacts.broad_phase(scene, contact)),
        narrow_phase=decide(contacts.narrow_phase(contact)),
        impact_time=decide(_impact_time(scene, contact)),
        colouring=decide(contacts.colouring(scene, contact)),
        stabilisation=decide(contacts.stabilisation(scene, contact)),
        forces=forces,
        tree=decide(_tree(scene)),
        potential=decide(_potential(scene, forces[GRAVITY.name])),
        resting=decide(contacts.resting(scene, contact)),
        restitution=decide(contacts.restitution(scene, contact)),
        friction=friction,
        torque=torque,
        energy=_energy(scene),
    )


def _forced(scene: Scene) -> dict[str, str]:
    """Return the parts that are forced on, each with the one in ``model.force`` that wants it."""
    forced = {name: name for name in scene.model.force}
    for name in scene.model.force:
        for needed in _NEEDS.get(name, ()):
            forced.setdefault(needed, name)
    return forced


def _contradiction(scene: Scene, name: str) -> str:
    """Say why a part that is not required cannot be forced on, and what would do it; empty if it can."""
    match name:
        case "contact" if not scene.contact.enabled:
            return "contact.enabled = false; set it to true"
        case "tree":
            return 'it takes the place of the direct sum; set gravity.method = "tree"'
        case "restitution":
            return "it is a factor of every impulse, 1 + e, and e is 0; set contact.restitution"
        case "stabilisation" if scene.contact.stabilisation == "none":
            return 'contact.stabilisation = "none"; set it to "split"'
        case "time-of-impact" if scene.contact.timing == "end-of-step":
            return 'contact.timing = "end-of-step"; set it to "time-of-impact"'
        case "time-of-impact" if not integrator(scene).drifts_once:
            return f'a step of {integrator(scene).name} is more than one drift; set time.integrator = "leapfrog"'
        case "adaptive-step":
            return "time.fixed_dt sets the step; leave it out"
    return next((kind.contradiction(scene) for kind in FORCES if kind.name == name), "")


def gravity_method(scene: Scene) -> Literal["direct", "tree", "none"]:
    """Decide how the pull is summed.

    Both take as long for 800 bodies in a uniform ball and for 2000 in a cluster. "auto" waits for `TREE_FROM`: up to
    there a tree saves milliseconds at most, and the direct sum keeps momentum to round-off.
    """
    method = scene.gravity.method
    if method == "none" or not (pulls.gravity(scene).modelled or "gravity" in _forced(scene)):
        return "none"
    if method == "auto":
        return "direct" if scene.count < TREE_FROM else "tree"
    return method


def _tree(scene: Scene) -> Part:
    name, method, n = "tree", gravity_method(scene), scene.count
    if method == "none":
        return Part(name, False, "nothing pulls")
    few = f"{n} bodies, {'fewer than' if n < TREE_FROM else 'at least'} {TREE_FROM}"
    why = few if scene.gravity.method == "auto" else f'gravity.method = "{method}"'
    if method == "direct":
        return Part(name, False, f"{why}: a direct sum")
    poles = "" if scene.gravity.quadrupoles else ", no quadrupoles"
    return Part(name, True, f"{why}; opening angle {scene.gravity.opening_angle:g}{poles}")


def _potential(scene: Scene, gravity: Part) -> Part:
    if not gravity.modelled:
        return Part("potential", False, "nothing pulls")
    return Part("potential", True, f"every {scene.record.check_every} steps and at frames")


def _energy(scene: Scene) -> Part:
    return Part("energy", True, f"every {scene.record.check_every} steps and at frames; the ledger")


def timing(scene: Scene) -> Literal["end-of-step", "time-of-impact"]:
    """Decide when impacts are resolved: at their own moments, unless the bodies' own gravity presses them together.

    Without a load flight is free, and a run is exact to rounding with steps many times as long. Under a uniform field
    a heap that falls costs a sixth more and overlaps by a sixth as much. Under self-gravity an impact at its own moment
    costs more than it gains (docs/trade.md).
    """
    return "end-of-step" if _why_late(scene) else "time-of-impact"


def _why_late(scene: Scene) -> str:
    """Say why impacts wait for the end of the step; empty if they do not."""
    asked, chosen = scene.contact.timing, integrator(scene)
    if asked != "auto":
        return f'contact.timing = "{asked}"' if asked == "end-of-step" else ""
    if not contacts.contact(scene).modelled:
        return "no contact is possible"
    if contacts.load(scene) and not contacts.field_presses(scene):
        return "the bodies' own gravity presses contacts together"
    return "" if chosen.drifts_once else f"a step of {chosen.name} is more than one drift"


def _impact_time(scene: Scene, contact: Part) -> Part:
    name, late = "time-of-impact", _why_late(scene)
    if contact.modelled and late:
        return Part(name, False, f"{late}: an impact is resolved up to a step late")
    asked = scene.contact.timing == "time-of-impact"
    why = 'contact.timing = "time-of-impact"' if asked else "no self-gravity presses contacts together"
    return contacts.where_bodies_meet(name, contact, f"{why}: impacts are resolved at their own moments within a step")


def _spin(scene: Scene, friction: Part) -> Part:
    if friction.modelled:
        return Part("spin", True, "friction turns bodies")
    if _starts_spinning(scene):
        return Part("spin", True, "bodies spin at the start")
    return Part("spin", False, "no friction, and nothing spins at first")


def _orientation(scene: Scene, friction: Part) -> Part:
    if friction.modelled or _starts_spinning(scene):
        return Part("orientation", True, "what spins is seen to turn")
    return Part("orientation", False, "nothing spins")


def _starts_spinning(scene: Scene) -> bool:
    return any(any(body.angular_velocity) for body in scene.body) or any(
        group.spin.dispersion > 0 or any(group.bulk_rotation) for group in scene.group
    )


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


def _integrator(scene: Scene) -> Part:
    name, chosen = "integrator", integrator(scene).name
    if scene.time.integrator != AUTO:
        return Part(name, True, f'time.integrator = "{chosen}"')
    if chosen == "yoshida4":
        return Part(name, True, f"yoshida4: {scene.count} bodies pull each other, and no contact is modelled")
    if force := pulls.damping(scene):
        why = f"its one drift has room for the {force.name}"
    elif not pulls.gravity(scene).modelled:
        why = "exact without a pull between bodies"
    elif contacts.contact(scene).modelled:
        late = timing(scene) == "end-of-step"
        why = f"contacts are found {'at the end' if late else 'in the one drift'} of a step, whatever the order"
    else:
        why = f"{scene.count} bodies, whose encounters the step does not resolve"
    return Part(name, True, f"leapfrog: {why}")


def _adaptive_step(scene: Scene) -> Part:
    name = "adaptive-step"
    if scene.time.fixed_dt is not None:
        return Part(name, False, f"time.fixed_dt = {scene.time.fixed_dt:g} s")
    return Part(name, True, ", ".join(_limits(scene)) or "nothing can touch and nothing pulls: max_dt")


def _limits(scene: Scene) -> list[str]:
    """Describe what limits the step besides ``max_dt``."""
    texts = []
    if (part := cfl(scene)) is not None:
        texts.append(f"cfl = {part:g}")
    if (reach := target_dx(scene)) is not None:
        of_fall = f": {_auto_step(scene):g} of a fall through the smallest radius"
        texts.append(f"target_dx = {reach:.3g} m" + (of_fall if scene.time.target_dx == "auto" else ""))
    if (fraction := pull_fraction(scene)) is not None:
        times = "shortest time of a pair" if scene.count <= PAIRS_UP_TO else "time of the largest pull"
        texts.append(f"pull_fraction = {fraction:g} of the {times}")
    return texts


def _warm_up(scene: Scene) -> Part:
    if scene.time.fixed_dt is not None:
        return Part("warm-up", False, "time.fixed_dt: no step has to be found")
    return Part("warm-up", True, "adaptive steps begin with accelerations")


def target_dx(scene: Scene) -> float | None:
    """Return the farthest that the largest acceleration may move a body in a step, in metres; None for no limit.

    A fall from rest through the smallest radius r takes √(2 r/a); a part s of that time is s² r of the way. Where
    nothing can touch, radii have no say.
    """
    if scene.time.target_dx != "auto":
        return scene.time.target_dx
    if not contacts.contact(scene).modelled:
        return None
    return _auto_step(scene) ** 2 * smallest_radius(scene)


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


def _auto_step(scene: Scene) -> float:
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
