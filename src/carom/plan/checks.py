"""Checks before a run: refusals of scenes, and doubts about valid ones."""

from __future__ import annotations

import math

import numpy as np

from carom import registry
from carom.errors import SceneError
from carom.plan.auto import gravity_method, integrator, uses_tree
from carom.plan.features import require
from carom.plan.hierarchy import why_no_hierarchy
from carom.plan.interactions import dampings, differing, pushing
from carom.plan.room import refuse_small_memory
from carom.plan.step_parts import STEP_PARTS, required
from carom.scene.contact_laws import law_called
from carom.scene.explanation import naming_places
from carom.scene.forces import DRAG
from carom.scene.installed_forces import BodyForce, PairForce, force_called
from carom.scene.integrators import ENCOUNTERS_BY
from carom.scene.load import Scene
from carom.scene.pistons import pistons_of
from carom.scene.scene_file import KeyPath
from carom.scene.units.dimension import ACCELERATION, DENSITY, LENGTH
from carom.scene.wall_shapes import shape_called
from carom.scene.wording import body_key, counted

EARTH = 9.81  # m/s², as a user writes it: 9.8 to 9.82
# largest relative difference from `EARTH`; the field is 0.2 % stronger at the poles, and 0.3 % weaker at the equator
AS_ON_EARTH = 0.01
NARROWEST = 4  # smallest width of a box, in largest radii, so that no body touches another body and its image at once
LIGHTEST = 100.0  # kg/m³, density of the lightest solid; balls of cork have 200

INTEGRATOR: KeyPath = ("time", "integrator")
METHOD: KeyPath = ("gravity", "method")
BOUNDARY: KeyPath = ("domain", "boundary")


# Errors of the positions in a cluster of 6000 points (docs/trade.md): the error at an opening angle of 1 rad, relative
# to the size of the system, and the power of the angle with which it grows.
TREE_ERRORS = {
    "tree": (6e-4, 4),  # the tree with quadrupoles errs by 5 × 10⁻⁶ at 0.3 rad, and by 1.2 × 10⁻⁴ at 0.7
    # the fast multipole method errs by at most 1.8 × 10⁻⁸ at 0.3 rad, 1.2 × 10⁻⁶ at 0.5, and 1.7 × 10⁻⁵ at 0.7
    "fast-multipole": (5e-4, 7),
}
MONOPOLES = 19.0  # largest factor by which the error is larger without quadrupoles
SMALLEST_ANGLE = 0.1  # rad, angle below which a direct sum is as fast


def refuse_impossible(scene: Scene) -> None:
    """Refuse a scene that cannot run on this machine or in this installation.

    Raises
    ------
    SceneError
        The message names the key and a valid value.
    """
    with naming_places(scene):
        _refuse_missing_parts(scene)
        _refuse_test_particles(scene)
        _refuse_coarse_tree(scene)
        _refuse_integrator(scene)
        _refuse_thin_walls(scene)
        _refuse_laws_without_coefficients(scene)
        _refuse_further_forces(scene)
        _refuse_what_no_error_controls(scene)
        _refuse_what_is_no_hierarchy(scene)
        refuse_small_memory(scene)
        _refuse_narrow_box(scene)


def _refuse_missing_parts(scene: Scene) -> None:
    """Refuse a scene that needs a part which was deleted from this installation (`carom.registry`)."""
    chosen, method = integrator(scene), gravity_method(scene)
    without_radau = 'set time.integrator = "leapfrog"'
    needed: list[tuple[str, str, KeyPath, str]] = []
    if chosen.controls_error:
        needed.append(("integrators", chosen.name, INTEGRATOR, without_radau))
    if chosen.hierarchical:  # gauss-radau15, for close encounters
        needed.append(("integrators", ENCOUNTERS_BY, INTEGRATOR, without_radau))
    if method != "none":
        needed.append(("gravity_methods", method, METHOD, 'set gravity.method = "direct"'))
    if scene.drag is not None:
        needed.append(("forces", DRAG.name, ("drag",), "leave [drag] out"))
    for number in pistons_of(scene):
        needed.append(("model", "piston", ("plane", number, "piston"), "remove the piston"))
    missing = [each for each in needed if each[1] not in registry.names(each[0])]
    parts = {name: STEP_PARTS[name] for name in required(scene, require(scene), recorded=False)}
    missing += [("model", name, part.key, part.remedy(scene)) for name, part in parts.items() if not part.is_there]
    for kind, name, key, remedy in missing:
        called = registry.KINDS.get(kind, "part of the model")
        raise registry.ExtensionError(
            f'this scene needs the {called} "{name}", which this installation of carom lacks; {remedy}, or '
            "install carom again",
            key,
        )


def _refuse_test_particles(scene: Scene) -> None:
    """Refuse bodies of mass 0 in scenes with contacts, and scenes with bodies of mass 0 only."""
    count = scene.test_particles
    touches = count > 0 and require(scene).contact.modelled
    if not touches and (count == 0 or count < scene.count):
        return
    single = [("body", index, "mass") for index, body in enumerate(scene.body) if body.mass == 0.0]
    grouped = [("group", index, "mass") for index, group in enumerate(scene.group) if group.mass == 0.0]
    if single or grouped:
        key: KeyPath = (single or grouped)[0]
        wrong = f"{'.'.join(map(str, key))} = 0"
    else:
        index = next(index for index, columns in enumerate(scene.data) if columns.massless)
        key, called = ("bodies", index, "file"), scene.bodies[index].called
        wrong = f"bodies.{index}: {called} has {counted(scene.data[index].massless, 'body')} of mass 0"
    if count == scene.count:
        raise SceneError(f"{wrong}: all bodies are test particles, which do not attract; give one of them a mass", key)
    raise SceneError(
        f"{wrong}: the impulse of a test particle in a contact is not defined; set contact.enabled = false, or give it "
        "a mass",
        key,
    )


def _refuse_coarse_tree(scene: Scene) -> None:
    """Refuse a tree whose error exceeds the requested one; the message names a sufficient opening angle."""
    accuracy, gravity, method = scene.time.accuracy, scene.gravity, gravity_method(scene)
    if accuracy is None or method not in TREE_ERRORS:
        return
    at_1_rad, order = TREE_ERRORS[method]
    if method == "tree" and not gravity.quadrupoles:
        at_1_rad *= MONOPOLES
    error, angle = at_1_rad * gravity.opening_angle**order, (accuracy / at_1_rad) ** (1 / order)
    if error <= accuracy:
        return
    tree = f'gravity.method = "{method}" and opening_angle = {gravity.opening_angle:g}'
    rounded = int(100 * angle) / 100  # rounded down
    better = f"gravity.opening_angle = {rounded}" if angle >= SMALLEST_ANGLE else 'gravity.method = "direct"'
    raise SceneError(
        f"time.accuracy = {accuracy:g} with {tree}, whose error is about {error:.0e}; set {better}",
        ("time", "accuracy"),
    )


def _refuse_integrator(scene: Scene) -> None:
    """Refuse an integrator that cannot treat the contacts, the damping or the walls of a scene."""
    chosen, needs = integrator(scene), require(scene)
    if not chosen.locates_impacts and needs.impact_time.modelled:
        why = "goes back in time within each step" if chosen.steps_back else "drifts twice in each step"
        raise SceneError(
            f'contact.timing = "time-of-impact" with time.integrator = "{chosen.name}", which {why}; '
            'use "leapfrog", or contact.timing = "end-of-step"',
            INTEGRATOR if scene.contact.timing == "auto" else ("contact", "timing"),
        )
    if not (chosen.holds_contacts or chosen.controls_error) and needs.resting.modelled:
        raise SceneError(
            f'time.integrator = "{chosen.name}" where bodies may press on each other: it computes forces in the '
            'middle of the step, but contacts need the forces at the end; use "leapfrog", or set contact.enabled = '
            "false",
            INTEGRATOR,
        )
    forces = dampings(scene)
    if len(forces) > 1:
        names = " and ".join(f"[{force.name}]" for force in forces)
        raise SceneError(f"{names}: a scene has at most one force that depends on velocities; remove one")
    if forces and not chosen.damps:
        force = forces[0]
        raise SceneError(
            f'time.integrator = "{chosen.name}" with [{force.name}]: the {force.name} needs one drift between two '
            'equal kicks; use "leapfrog" or "auto"',
            INTEGRATOR,
        )
    if scene.wall and chosen.controls_error:
        raise SceneError(
            f'time.integrator = "{chosen.name}" does not support a [[wall]]; set time.integrator = "leapfrog"',
            INTEGRATOR,
        )
    if scene.translating and chosen.controls_error:
        raise SceneError(
            f'time.integrator = "{chosen.name}" does not support moving planes; set time.integrator = "leapfrog"',
            INTEGRATOR,
        )


def _refuse_thin_walls(scene: Scene) -> None:
    """Refuse thin walls if impacts are resolved late, since bodies would pass through them."""
    needs = require(scene)
    thin = next((wall.shape for wall in scene.wall if shape_called(wall.shape).thin), "")
    if thin and needs.contact.modelled and not needs.impact_time.modelled:
        raise SceneError(
            f"bodies may pass a thin wall ({thin}) within a step if impacts are resolved at its end "
            '(contact.timing = "end-of-step"); set contact.timing = "time-of-impact", with an integrator such '
            "as leapfrog",
            ("contact", "timing"),
        )


def _refuse_laws_without_coefficients(scene: Scene) -> None:
    """Refuse a contact law without effect: all of its coefficients are 0 because no section states any.

    The schema accepts such a law, so that recordings of such scenes can be read.
    """
    for name in scene.contact.laws:
        default = scene.contact.law_section(name)
        if default is None:
            continue
        surfaces = (*scene.material, *scene.pair, *scene.plane, *scene.wall)
        sections = [default, *(getattr(surface, name) for surface in surfaces)]
        if any(section is not None and section.model_fields_set for section in sections):
            continue
        if not any(law_called(name).coefficients(default).values()):
            keys = " or ".join(type(default).model_fields)
            raise SceneError(
                f'contact.law = "{name}" without a coefficient has no effect; give {keys} in [contact.{name}], or '
                "remove the law",
                ("contact", "law"),
            )


def _refuse_further_forces(scene: Scene) -> None:
    """Refuse the forces of installed packages in scenes for which these forces are not defined."""
    for name in scene.forces.given:
        force = force_called(name)
        if isinstance(force, BodyForce) and not force.periodic and scene.domain.is_periodic:
            raise SceneError(
                f"[forces.{name}] in a periodic box: its potential differs on opposite faces; set domain.boundary = "
                '"open" or "walls"',
                BOUNDARY,
            )
        if isinstance(force, PairForce) and scene.test_particles:
            raise SceneError(
                f"[forces.{name}] with a body of mass 0: a force between bodies would accelerate it without bound; "
                "give it a mass",
                ("forces", name),
            )


def _refuse_what_no_error_controls(scene: Scene) -> None:
    """Refuse settings that cause errors which the integrator's error estimate does not include."""
    chosen, contact = integrator(scene), scene.contact
    if not chosen.ends_steps_at_impacts:
        return
    name = f'time.integrator = "{chosen.name}"'
    if require(scene).contact.modelled and contact.timing == "end-of-step":
        raise SceneError(
            f'contact.timing = "end-of-step" with {name}, which ends its steps at impacts; '
            'remove contact.timing, or use "leapfrog"',
            ("contact", "timing"),
        )
    if require(scene).contact.modelled and contact.allow_overlap:
        raise SceneError(
            f"contact.allow_overlap with {name}, which does not correct overlaps; "
            'remove contact.allow_overlap, or use "leapfrog"',
            ("contact", "allow_overlap"),
        )
    if scene.domain.is_periodic:
        raise SceneError(
            f'{name} in a periodic box: it supports only open space; use "leapfrog" or "yoshida4"', BOUNDARY
        )
    if uses_tree(scene):
        raise SceneError(
            f'{name} with gravity.method = "{gravity_method(scene)}", whose error it cannot control; set "direct"',
            METHOD,
        )
    if key := _limit_of_steps(scene):
        raise SceneError(
            f"time.{key} with {name}, which chooses the step by its own error; remove time.{key}", ("time", key)
        )


def _refuse_what_is_no_hierarchy(scene: Scene) -> None:
    """Refuse scenes without orbits about a dominant body if the integrator requires them."""
    chosen = integrator(scene)
    if not chosen.hierarchical:
        if scene.time.encounters != "resolve":
            raise SceneError(
                f'time.encounters = "{scene.time.encounters}" with time.integrator = "{chosen.name}", which does not '
                'treat encounters separately; remove time.encounters, or use "wisdom-holman"',
                ("time", "encounters"),
            )
        return
    name = f'time.integrator = "{chosen.name}"'
    if require(scene).contact.modelled:
        raise SceneError(
            f"{name} where bodies may touch: it does not resolve contacts; set contact.enabled = false, "
            'or use "leapfrog"',
            INTEGRATOR,
        )
    if scene.domain.is_periodic:
        raise SceneError(f'{name} in a periodic box: it supports only open space; use "leapfrog"', BOUNDARY)
    if uses_tree(scene):
        raise SceneError(
            f'{name} with gravity.method = "{gravity_method(scene)}": it sums all pairs; set "direct"', METHOD
        )
    if scene.forces.given:
        raise SceneError(
            f"{name} with [forces.{next(iter(scene.forces.given))}], under which orbits are not Keplerian; use "
            '"gauss-radau15" or "auto"',
            INTEGRATOR,
        )
    if why := why_no_hierarchy(scene):
        raise SceneError(f"{name} {why}", INTEGRATOR)
    if key := _limit_of_steps(scene):
        raise SceneError(
            f"time.{key} with {name}, whose step follows from the orbits; use time.fixed_dt instead", ("time", key)
        )


def _limit_of_steps(scene: Scene) -> str:
    """Return the first key that limits the steps of kicks and drifts; empty if none is given."""
    return next((key for key in ("target_dx", "cfl", "pull_fraction") if getattr(scene.time, key) != "auto"), "")


def _refuse_narrow_box(scene: Scene) -> None:
    """Refuse periodic boxes so small that a body could touch its own image, or another body and its image."""
    if not scene.domain.is_periodic or scene.domain.size is None:
        return
    given = [body.radius for body in scene.body] + [columns.radii[1] for columns in scene.data]
    largest, units = max(given + [group.radius.max for group in scene.group]), scene.unit_system
    if min(scene.domain.size[axis] for axis in scene.domain.repeating) < NARROWEST * largest:
        least = units.text(NARROWEST * largest, LENGTH, "g")
        raise SceneError(
            f"domain.size = {units.vector(scene.domain.size, LENGTH)}: the width of a periodic box must be at "
            f"least four times the largest radius ({least}), or a body may touch another body and its image at once",
            ("domain", "size"),
        )


def doubts(scene: Scene) -> list[str]:
    """Return a sentence for each probable mistake in a scene."""
    found, units = list[str](), scene.unit_system
    moving = bool(differing(scene) or pushing(scene) or dampings(scene) or scene.contact.allow_overlap)
    moving |= scene.domain.shear is not None
    moving |= any(any(body.velocity) or any(body.angular_velocity) for body in scene.body)
    for columns in scene.data:
        moving |= bool(columns.velocity.any() or columns.angular_velocity.any())
    for group in scene.group:
        moving |= any(group.velocity.mean) or group.velocity.dispersion > 0.0
        moving |= group.spin.dispersion > 0.0 or any(group.bulk_rotation)
    if not moving:
        found.append("nothing can move: no force acts, and every velocity is 0")
    # the number has the digits of the Earth's field, but another order of magnitude
    size = math.hypot(*scene.gravity.uniform)
    same_digits = round(units.shown(size, ACCELERATION), 1) == round(EARTH, 1)
    if same_digits and not math.isclose(size, EARTH, rel_tol=AS_ON_EARTH):
        text = units.text(size, ACCELERATION, ".3g")
        found.append(
            f"gravity.uniform has {text}, {size / EARTH:.2g} of the Earth's; for the Earth's field, write "
            f'"{EARTH} m/s^2"'
        )
    for index, wall in enumerate(scene.wall):
        if (doubts_of := shape_called(wall.shape).doubts) is not None:
            said = doubts_of(wall.section, _median_radius(scene), units)
            found += [f"wall.{index}.{wall.shape}: {sentence}" for sentence in said]
    # masses that, with the default radius, give a density lower than that of any solid
    light = [
        (number, density)
        for number, body in enumerate(scene.body)
        if "radius" not in body.model_fields_set and body.mass  # test particles have mass 0
        if (density := body.mass / (4.0 / 3.0 * math.pi * body.radius**3)) < LIGHTEST
    ]
    if light:
        number, density = light[0]
        more = f"; the same holds for {counted(len(light) - 1, 'more body')}" if len(light) > 1 else ""
        found.append(
            f"{body_key(number, scene.body[number].name)} has no radius and uses the default, "
            f"{units.text(scene.body[number].radius, LENGTH, 'g')}: with its mass, the density is "
            f"{units.text(density, DENSITY, '.2g')}{more}"
        )
    return found


def _median_radius(scene: Scene) -> float:
    """Return the median radius (m) of all bodies; a group counts with its radius, or the mean of its bounds."""
    parts = [np.array([body.radius for body in scene.body]), *(columns.radius for columns in scene.data)]
    parts += [np.full(group.count, 0.5 * (group.radius.min + group.radius.max)) for group in scene.group]
    return float(np.median(np.concatenate(parts)))
