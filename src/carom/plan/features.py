"""The parts of the model that a scene needs, and why; decided from the scene alone.

A part that is not required costs no time, no memory and no bytes in the recording. Leaving out an unneeded part does
not change the result.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from carom.errors import SceneError
from carom.plan import interactions
from carom.plan.auto import (
    BOUNCES_UP_TO,
    PAIRS_UP_TO,
    STRAIN_PER_STEP,
    TREE_FROM,
    auto_interval,
    auto_step,
    gravity_method,
    integrator,
    largest_step,
    step_limits,
    timing,
    uses_tree,
    why_late,
)
from carom.plan.hierarchy import heaviest, orbits_often
from carom.plan.interactions import forced_parts
from carom.plan.once_a_scene import once_a_scene
from carom.scene.contact_laws import DEFAULT_LAW
from carom.scene.forces import GRAVITY, UNIFORM_FIELD, kinds_of
from carom.scene.integrators import AUTO
from carom.scene.load import Scene
from carom.scene.parts import Part, in_order
from carom.scene.units.dimension import LENGTH, TIME
from carom.scene.wording import counted

# s, shortest and longest time to compile kernels for a law, walls or a sheared box (docs/performance.md)
VARIANT_SECONDS = 10.0, 40.0


@dataclass(frozen=True)
class Requirements:
    """The parts of the model that a scene requires, or that ``model.force`` switches on."""

    warm_up: Part
    adaptive_step: Part
    integrator: Part
    accuracy: Part
    spin: Part
    orientation: Part
    contact: Part
    broad_phase: Part
    narrow_phase: Part
    impact_time: Part
    colouring: Part
    stabilisation: Part
    forces: Mapping[str, Part]  # the force parts, by name
    tree: Part
    potential: Part
    resting: Part
    restitution: Part
    friction: Part
    torque: Part
    energy: Part
    release: Part | None = None  # None in scenes where no body enters or leaves

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts, in the order in which a step uses them."""
        parts = _by_name(self)
        return tuple(parts[name] for name in in_order(parts))

    @property
    def gravity(self) -> Part:
        """Whether bodies attract each other."""
        return self.forces[GRAVITY.name]

    @property
    def field(self) -> Part:
        """Whether there is a uniform field."""
        return self.forces[UNIFORM_FIELD.name]

    @property
    def accelerates(self) -> bool:
        """Whether a force accelerates bodies between contacts."""
        return any(part.modelled for part in self.forces.values())


@once_a_scene
def require(scene: Scene) -> Requirements:
    """Decide which parts a scene needs, and switch on the parts named in ``model.force``.

    Raises
    ------
    SceneError
        If a part cannot be forced.
    """
    forced, required = forced_parts(scene), _decide(scene, {})
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
    others = {key: explained(part) for key, part in decided.items() if isinstance(part, Part)}
    return Requirements(**others, forces=forces)


def own_kernels(scene: Scene) -> list[str]:
    """Return the parts of a scene that have kernels of their own, which may have to be compiled on this machine first.

    Laws, shapes of walls, moving walls and sheared boxes are compiled into the kernels of contacts.
    """
    law = scene.contact.law
    laws = [law] if isinstance(law, str) else law
    found = [f'contact.law = "{name}"' for name in laws if name != DEFAULT_LAW and scene.contact.enabled]
    shapes = sorted({wall.shape for wall in scene.wall})
    found += [f"[[wall]] ({', '.join(shapes)})"] if shapes else []
    found += ["moving walls"] if scene.translating or any(wall.moves for wall in scene.wall) else []
    found += ["domain.shear"] if scene.domain.shear else []
    return found


def _by_name(needs: Requirements) -> dict[str, Part]:
    single = [part for part in vars(needs).values() if isinstance(part, Part)]
    return {part.name: part for part in (*single, *needs.forces.values())}


def _decide(scene: Scene, forced: Mapping[str, str]) -> Requirements:
    """Decide on each part. A forced part has the same consequences as a required one."""

    def decide(part: Part) -> Part:
        if part.modelled or part.name not in forced:
            return part
        contradiction = _contradiction(scene, part.name)
        if contradiction:
            raise SceneError(f"model.force: {forced[part.name]} cannot be forced on: {contradiction}")
        return Part(part.name, True, part.why)

    steps, duration = scene.record.check_every, scene.time.duration
    times = round(duration / auto_interval(scene, duration))
    forces = {kind.name: decide(interactions.part(kind, scene)) for kind in kinds_of(scene)}
    contact = decide(interactions.contact(scene))

    def where_bodies_meet(name: str, why: str) -> Part:
        return decide(interactions.where_bodies_meet(name, contact, why))

    search = "k-d tree" if scene.contact.search == "k-d-tree" else "hierarchical grid"
    apart = "no two contacts of a stage share a body" if scene.contact.colouring == "contacts" else "of bodies"
    friction = decide(interactions.friction(scene, contact))
    torque = decide(interactions.torque(friction))
    if forces[GRAVITY.name].modelled:
        potential = Part("potential", True, f"every {steps} steps, {times} times a run and at frames")
    else:
        potential = Part("potential", False, "no gravity between bodies")
    if scene.time.fixed_dt is None:
        warm_up = Part("warm-up", True, "the first adaptive step needs accelerations")
    else:
        warm_up = Part("warm-up", False, "time.fixed_dt is set: no first step to determine")
    return Requirements(
        warm_up=decide(warm_up),
        adaptive_step=decide(_adaptive_step(scene)),
        integrator=_integrator(scene),
        accuracy=decide(_accuracy(scene)),
        spin=decide(_spin(scene, friction)),
        orientation=decide(_orientation(scene, friction)),
        contact=contact,
        broad_phase=where_bodies_meet("broad-phase", f"one {search} for each octave of radius"),
        narrow_phase=where_bodies_meet("narrow-phase", "the distance of each pair that may touch"),
        impact_time=decide(_impact_time(scene, contact)),
        colouring=where_bodies_meet("colouring", apart),
        stabilisation=decide(interactions.stabilisation(scene, contact)),
        forces=forces,
        tree=decide(_tree(scene)),
        potential=decide(potential),
        resting=decide(interactions.resting(scene, contact)),
        restitution=decide(interactions.restitution(scene, contact)),
        friction=friction,
        torque=torque,
        energy=Part("energy", True, f"checked every {steps} steps and {times} times a run; the ledger"),
        release=Part("release", True, _why_released(scene)) if scene.admits else None,
    )


def _contradiction(scene: Scene, name: str) -> str:
    """Return why a part cannot be forced, and the remedy; empty if it can."""
    match name:
        case "contact" if not scene.contact.enabled:
            return "contact.enabled = false; set it to true"
        case "tree":
            return 'it replaces the direct sum; set gravity.method = "tree" or "fast-multipole"'
        case "restitution":
            return "it is a factor of every impulse, 1 + e, and e is 0; set contact.restitution"
        case "stabilisation" if scene.contact.stabilisation == "none":
            return 'contact.stabilisation = "none"; set it to "split"'
        case "time-of-impact" if scene.contact.timing == "end-of-step":
            return 'contact.timing = "end-of-step"; set it to "time-of-impact"'
        case "time-of-impact" if not integrator(scene).locates_impacts:
            return f'a step of {integrator(scene).name} is more than one drift; set time.integrator = "leapfrog"'
        case "accuracy":
            return "it needs a value; set time.accuracy"
        case "adaptive-step":
            return "time.fixed_dt sets the step; remove it"
    return next((kind.contradiction(scene) for kind in kinds_of(scene) if kind.name == name), "")


def _tree(scene: Scene) -> Part:
    name, method, n = "tree", gravity_method(scene), scene.count
    if method == "none":
        return Part(name, False, "no gravity between bodies")
    few = f"{n} bodies, {'fewer than' if n < TREE_FROM else 'at least'} {TREE_FROM}"
    why = few if scene.gravity.method == "auto" else f'gravity.method = "{method}"'
    if method == "direct":
        return Part(name, False, f"{why}: a direct sum")
    poles = ", no quadrupoles" if method == "tree" and not scene.gravity.quadrupoles else ""
    return Part(name, True, f"{why}; opening angle {scene.gravity.opening_angle:g}{poles}")


def _impact_time(scene: Scene, contact: Part) -> Part:
    name, late, chosen = "time-of-impact", why_late(scene), integrator(scene)
    if chosen.ends_steps_at_impacts:
        return interactions.where_bodies_meet(name, contact, f"steps of {chosen.name} end at impacts")
    if contact.modelled and late:
        return Part(name, False, f"{late}: impacts are resolved up to a step late")
    why = "impacts are resolved at their exact times within a step"
    if scene.contact.timing == "time-of-impact":
        why = f'contact.timing = "time-of-impact": {why}'
    return interactions.where_bodies_meet(name, contact, why)


def _why_released(scene: Scene) -> str:
    """Return a text with the number of bodies that enter, and the outlets."""
    entering = sum(group.count for group in scene.group if group.release is not None)
    said = [f"{counted(entering, 'body')} enter later"] if entering else []
    return "; ".join([*said, *(f"bodies leave by {name}" for name in scene.outlet_names)])


def _spin(scene: Scene, friction: Part) -> Part:
    if friction.modelled:
        return Part("spin", True, "friction turns bodies")
    if _starts_spinning(scene):
        return Part("spin", True, "bodies spin at the start")
    return Part("spin", False, "no friction, and nothing spins at the start")


def _orientation(scene: Scene, friction: Part) -> Part:
    if friction.modelled or _starts_spinning(scene):
        return Part("orientation", True, "bodies spin")
    return Part("orientation", False, "nothing spins")


def _starts_spinning(scene: Scene) -> bool:
    return (
        any(any(body.angular_velocity) for body in scene.body)
        or any(columns.spins for columns in scene.data)
        or any(group.spin.dispersion > 0 or any(group.bulk_rotation) for group in scene.group)
    )


def _integrator(scene: Scene) -> Part:
    name, chosen = "integrator", integrator(scene).name
    if scene.time.integrator != AUTO:
        return Part(name, True, f'time.integrator = "{chosen}"')
    if chosen == "wisdom-holman":
        heavy, fraction = heaviest(scene)
        turns = f"the innermost body completes {orbits_often(scene):.3g} orbits"
        return Part(name, True, f"{chosen}: {heavy} has {100.0 * fraction:.5g} % of the mass, and {turns}")
    if scene.time.accuracy is not None and (chosen != "leapfrog" or interactions.load(scene)):
        return Part(name, True, f"{chosen}: {_why_accurate(scene, chosen)}")
    if chosen == "gauss-radau15" and interactions.contact(scene).modelled:
        why = f"{scene.count} bodies start far apart and seldom collide; impacts end its steps"
    elif chosen == "gauss-radau15":
        why = f"{scene.count} bodies attract each other, no contact is modelled, and the scene sets no step"
    elif chosen == "yoshida4":
        why = f"{scene.count} bodies attract each other, and no contact is modelled"
    elif force := interactions.damping(scene):
        why = f"the only integrator that supports {force.name}"
    elif not interactions.differing(scene):
        why = "exact between impacts, since bodies do not attract each other"
    elif interactions.contact(scene).modelled:
        late = timing(scene) == "end-of-step"
        why = f"contacts are detected {'at the end' if late else 'in the single drift'} of a step"
    else:
        why = f"{scene.count} bodies, whose encounters the step does not resolve"
    return Part(name, True, f"{chosen}: {why}")


def _why_accurate(scene: Scene, chosen: str) -> str:
    """Return why an integrator is the cheapest for an accuracy."""
    if scene.promise is not None and chosen == scene.promise.integrator != "wisdom-holman":
        return "the cheapest that keeps the accuracy, by trial runs"
    if chosen == "yoshida4":
        if uses_tree(scene):
            return "the accuracy is requested with a gravity tree, whose error gauss-radau15 cannot control"
        return f"the accuracy, and {scene.count} bodies; gauss-radau15 would sum all pairs several times a step"
    if chosen == "wisdom-holman":
        return "the bodies orbit a dominant one, and it is cheaper than gauss-radau15 at this accuracy"
    if chosen == "gauss-radau15" and interactions.contact(scene).modelled:
        return "its steps end at impacts and have only rounding errors; leapfrog takes over when contacts come to rest"
    if chosen == "gauss-radau15":
        return "cheapest for the accuracy, and no contact is modelled"
    if force := interactions.damping(scene):
        return f"the only integrator that supports {force.name}"
    if scene.count > BOUNCES_UP_TO:
        return f"{scene.count} bodies, more than {BOUNCES_UP_TO}, which gauss-radau15 would stop at each impact"
    beyond = "overlap at the start" if scene.contact.allow_overlap else f"the {scene.gravity.method} method"
    return f"gauss-radau15 does not support {beyond}"


def _accuracy(scene: Scene) -> Part:
    name, promise = "accuracy", scene.promise
    if scene.time.accuracy is None:
        return Part(name, False, "time.accuracy is not set")
    if promise is None:
        return Part(name, True, f"time.accuracy = {scene.time.accuracy:g}: the step follows from trial runs")
    kept = (
        "to the end" if promise.horizon is None else f"up to t = {scene.unit_system.text(promise.horizon, TIME, '.4g')}"
    )
    if promise.is_extrapolated:
        kept += f", extrapolated from t = {scene.unit_system.text(promise.looked or 0.0, TIME, '.4g')} on"
    length = "of the usual length"
    if promise.refinement < 1.0:
        length = f"{1.0 / promise.refinement:.3g} times longer than usual"
    elif promise.refinement > 1.0:
        length = f"{promise.refinement:.3g} times shorter than usual"
    return Part(name, True, f"steps {length}; kept {kept}")


def _adaptive_step(scene: Scene) -> Part:
    name = "adaptive-step"
    if scene.time.fixed_dt is not None:
        return Part(name, False, f"time.fixed_dt = {scene.unit_system.text(scene.time.fixed_dt, TIME, 'g')}")
    capped = "" if math.isinf(largest_step(scene)) else ", and max_dt"
    if integrator(scene).hierarchical:
        return Part(name, True, f"a twentieth of the shortest orbit, or a fiftieth of heavy bodies' orbits{capped}")
    if integrator(scene).controls_error:
        return Part(name, True, f"the integrator's own estimate of its error{capped}")
    limits = ", ".join(_limits(scene))
    if scene.time.accuracy is not None:
        return Part(name, True, f"as short as the accuracy requires, by {limits or 'max_dt'}")
    return Part(name, True, limits or "nothing can touch and no force attracts: max_dt")


def _limits(scene: Scene) -> list[str]:
    """Describe the limits of the step other than ``max_dt``."""
    texts, limits = [], step_limits(scene)
    if limits.cfl is not None:
        texts.append(f"cfl = {limits.cfl:.3g}")
    if limits.target_dx is not None:
        texts.append(f"target_dx = {scene.unit_system.text(limits.target_dx, LENGTH, '.3g')}")
        if scene.time.target_dx == "auto" and scene.promise is None:
            texts[-1] += f": {auto_step(scene):g} of the time of a fall through the smallest radius"
    if limits.pull_fraction is not None:
        times = "shortest time of a pair" if scene.count <= PAIRS_UP_TO else "time of the largest pull"
        texts.append(f"pull_fraction = {limits.pull_fraction:.3g} of the {times}")
    if scene.time.max_dt == "auto" and interactions.flow_presses(scene):
        largest = scene.unit_system.text(largest_step(scene), TIME, ".3g")
        texts.append(f"max_dt = {largest}: a strain of {STRAIN_PER_STEP:g}")
    return texts
