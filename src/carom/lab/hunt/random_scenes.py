"""The random scenes of a hunt: meeting bodies, crowds, columns, groups, planets, boundaries, pours, smooth motions.

Most scenes also get random values of other keys: forces, walls, planes (some of which move), materials and pairs,
units, steps, and the search and solution of contacts. Combinations that the schema refuses are only counted.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from carom.lab.hunt.documents import (
    Document,
    Draw,
    RandomDraw,
    Scales,
    decade,
    direction,
    fraction,
    impacts,
    meeting,
    one_in,
    row,
    scales,
    smooth,
    vector,
)
from carom.lab.hunt.random_boundaries import enclosed, poured
from carom.scene.parts import PARTS

MOST_BODIES = 16
DRIFT = 10.0  # common speed, relative to the bodies' own; small, since the energy scale excludes its rounding
MOST_FIXED = 200  # largest number of steps in a run with a fixed step
# one in this many scenes has bodies that enter and perhaps leave; such a scene has its own random numbers
SCENES_FOR_A_POUR = 12
SMOOTH_STEPS = 20
ORDERED = ("leapfrog", "leapfrog-dkd", "yoshida4")  # integrators of order two or more

SMOOTH, IMPACTS = "smooth", "impacts"  # kinds of scenes in which rounding errors stay small


@dataclass(frozen=True, slots=True)
class Drawn:
    """A drawn scene and its kind."""

    document: Document
    kind: str = ""


def drawn(seed: int, index: int) -> Drawn:
    """Draw a scene; equal numbers give equal scenes."""
    draw = RandomDraw(f"{seed} {index}")
    found, passes = _drawn(draw), RandomDraw(f"{seed} {index} passage")
    if not found.kind and one_in(passes, SCENES_FOR_A_POUR):
        found = Drawn(poured(passes, scales(passes)))
    if not found.kind and not any("piston" in plane for plane in found.document.get("plane", [])):
        _move_planes(RandomDraw(f"{seed} {index} motion"), found.document)
    found.document["title"] = f"Hunted scene {index}"
    for number, body in enumerate(found.document.get("body", [])):
        body["name"] = f"ball {number}"
    return found


def _drawn(draw: Draw) -> Drawn:
    kind = draw.integer(0, 31)
    if kind < 3:
        document = smooth(draw, steps=SMOOTH_STEPS, integrators=ORDERED)
        document["time"]["duration"] = SMOOTH_STEPS * document["time"]["fixed_dt"]
        if one_in(draw, 3):
            _set_drag(draw, document, document["time"]["duration"])
        return Drawn(document, SMOOTH)
    if kind < 5:
        document = impacts(draw)
        document["time"]["duration"] = 12 * document["time"]["fixed_dt"]
        return Drawn(document, IMPACTS)
    scale = scales(draw)
    if kind < 6:
        return Drawn(_planets(draw, scale))
    if kind > 21:
        return Drawn(enclosed(draw, scale))
    if kind > 19:
        return Drawn(_column(draw, scale))
    if kind < 8:
        document = _groups(draw, scale)
    elif kind < 12:
        document = _crowd(draw, scale)
    else:
        document = meeting(draw, scale=scale, most_bodies=MOST_BODIES, drift=DRIFT)
    # draws the keys that any scene may have; most keys keep their default
    time, contact, gravity = document["time"], document["contact"], document["gravity"]
    T = scale.L / scale.U
    _bound(draw, document, scale)
    _set_time(draw, time, T)
    contact["solver"] = draw.choice("lasting", "lasting", "staged")
    contact["search"] = draw.choice("grid", "grid", "k-d-tree")
    for key in sorted(contact):
        if one_in(draw, 4) and key != "allow_overlap":
            del contact[key]
    if gravity["constant"]:
        gravity["method"] = draw.choice("auto", "direct", "tree")
        if one_in(draw, 3):
            gravity |= {"opening_angle": draw.choice(0.3, 1.0), "quadrupoles": draw.choice(False, True)}
    if one_in(draw, 6):
        _set_drag(draw, document, T)
        document["drag"]["medium_velocity"] = row(vector(draw) * scale.U)
    if one_in(draw, 4):
        _set_materials(draw, document)
    if one_in(draw, 6):
        document["units"] = {
            "length": draw.choice("km", "cm", "au"),
            "time": draw.choice("h", "ms", "yr"),
            "mass": draw.choice("t", "g", "lb"),
        }
    if one_in(draw, 10):
        document["model"] = {"force": [draw.choice(*sorted(PARTS))]}
    _suit(document)
    return Drawn(document)


def _suit(document: Document) -> None:
    """Remove the parts of a scene that its integrator refuses."""
    time, contact = document["time"], document["contact"]
    if "drag" in document and time["integrator"] != "auto":
        time["integrator"] = "leapfrog"
    elif time["integrator"] == "gauss-radau15":
        for key in ("target_dx", "cfl", "smoothing", "velocity_limit"):
            time.pop(key, None)
        contact.pop("timing", None)
    elif time["integrator"] == "leapfrog-dkd":
        contact["enabled"] = False
    elif "accuracy" in time or time["integrator"] == "yoshida4":
        contact.pop("timing", None)


def _set_time(draw: Draw, time: Document, T: float) -> None:
    time["integrator"] = draw.choice(*[time["integrator"]] * 3, "auto", "auto", "leapfrog-dkd", "gauss-radau15")
    time["duration"] = T * draw.choice(0.3, 1.0, 3.0)
    if "fixed_dt" in time:
        time["duration"] = min(time["duration"], MOST_FIXED * time["fixed_dt"])
    elif one_in(draw, 8):
        for key in ("target_dx", "cfl", "smoothing", "velocity_limit"):
            time.pop(key, None)
        time |= {"accuracy": draw.choice(1e-3, 1e-6, 1e-9), "integrator": draw.choice("auto", "leapfrog", "yoshida4")}
    elif one_in(draw, 8):
        time["pull_fraction"] = draw.choice(0.01, 0.1)


def _bound(draw: Draw, document: Document, scale: Scales) -> None:
    """Put walls around a scene, planes beside it, or fix one of its bodies; not in a periodic box."""
    if "domain" in document or "group" in document:
        return
    bodies, gap = document["body"], draw.choice(0.0, 0.0, 0.01, 0.1, 1.0) * scale.L
    position = np.array([body["position"] for body in bodies])
    radius = np.array([body["radius"] for body in bodies])[:, None]
    low, high = (position - radius).min(axis=0), (position + radius).max(axis=0)
    kind = draw.integer(0, 9)
    if kind < 2:
        for body, place in zip(bodies, position - 0.5 * (low + high), strict=True):
            body["position"] = row(place)
        document["domain"] = {"boundary": "walls", "size": row((high - low) * (1.0 + 1e-9) + 2.0 * gap)}
    elif kind < 4:
        document["plane"] = [{"point": [0.0, 0.0, float(low[2]) - gap]}]
        if one_in(draw, 3):
            normal = direction(draw)
            lowest = float((position @ normal - radius[:, 0]).min())
            document["plane"].append({"point": row((lowest - gap) * normal), "normal": row(normal)})
        if one_in(draw, 3):
            document["plane"][0] |= {"restitution": fraction(draw), "static_friction": draw.choice(0.0, 1.0)}
    elif kind == 4:
        fixed = bodies[draw.integer(0, len(bodies) - 1)]
        fixed.pop("velocity", None)
        fixed.pop("angular_velocity", None)
        fixed["fixed"] = True


def _move_planes(draw: Draw, document: Document) -> None:
    """Let planes move by about a radius in some scenes; these draws have random numbers of their own."""
    time, planes, bodies = document["time"], document.get("plane", []), document.get("body", [])
    steps_by_impulse = time.get("integrator", "auto") in ("auto", "leapfrog") and "accuracy" not in time
    refused = not steps_by_impulse or "drag" in document or document["contact"].get("enabled") is False
    if refused or not planes or not bodies:  # bodies of a group fill the space between the planes
        return
    L, T = max(body.get("radius", 1.0) for body in bodies), time["duration"]
    for plane in planes:
        kind, way = draw.integer(0, 7), row(vector(draw) * L)
        if kind == 0:
            plane["motion"] = {"velocity": row(np.array(way) / T)}
        elif kind == 1:
            plane["motion"] = {"amplitude": row(0.1 * np.array(way)), "frequency": draw.choice(1.0, 3.0, 10.0) / T}
        elif kind == 2:
            velocities = [row(np.array(way) / T), row(vector(draw) * L / T), [0.0, 0.0, 0.0]]
            plane["motion"] = {"times": [0.1 * T, 0.3 * T, 0.7 * T], "velocities": velocities}


def _set_drag(draw: Draw, document: Document, T: float) -> None:
    document["drag"] = {"relaxation_time": T * decade(draw, -1, 1)}


def _set_materials(draw: Draw, document: Document) -> None:
    """Make bodies, planes and walls of two materials; contacts between the two may have their own coefficients."""
    names = ("soft", "hard")
    document["material"] = [
        {"name": name, "restitution": fraction(draw), "static_friction": draw.choice(0.0, 0.3, 1.0)} for name in names
    ]
    if one_in(draw, 2):
        document["material"][0]["density"] = 1000.0
    if one_in(draw, 2):
        document["pair"] = [{"materials": [draw.choice(*names), draw.choice("default", *names)], "restitution": 1.0}]
    for matter in [*document.get("body", []), *document.get("group", [])]:
        if one_in(draw, 2):
            matter["material"] = draw.choice(*names)
    for plane in document.get("plane", []):
        if len(plane) == 1:
            plane["material"] = draw.choice(*names)
    if document.get("domain", {}).get("boundary") == "walls":
        document["domain"]["material"] = draw.choice(*names)


def _crowd(draw: Draw, scale: Scales) -> Document:
    """Draw some hundred bodies on a jittered grid, where neighbours may touch within a step."""
    document, (L, U, M) = meeting(draw, scale=scale, most_bodies=1), scale
    side, pitch = draw.integer(4, 6), 2.0 * L * draw.choice(1.0 + 1e-9, 1.05, 1.3)
    slack = 0.5 * pitch - L
    bodies = []
    for index in range(side**3):
        place = np.array([index % side, index // side % side, index // side**2]) - 0.5 * (side - 1)
        jitter = np.array([draw.integer(-1000, 1000) / 1000 for _ in range(3)])
        body: Document = {"position": row(pitch * place + slack * jitter), "velocity": row(vector(draw) * U)}
        bodies.append(body | {"radius": L, "mass": M})
    document["body"] = bodies
    if "domain" in document:
        document["domain"]["size"] = [side * pitch] * 3
    return document


def _column(draw: Draw, scale: Scales) -> Document:
    """Draw a column whose bodies get heavier upwards, by mass alone or by radius, over a plane or a wall."""
    L, U, M = scale
    count, gap, aside = draw.integer(2, 5), draw.choice(0.0, 1e-3, 0.01, 0.05), draw.choice(0.0, 0.0, 1e-9, 1e-3)
    # decades of mass per ball; if the total ratio exceeds 10⁶, rounding shows in the ledger
    decades = draw.choice(1.0, 3.0, 6.0) / (count - 1)
    bodies: list[Document] = []
    z, grows = 0.0, draw.choice(False, True)
    for number in range(count):
        radius = L * (10.0 ** (decades * number / 3.0) if grows else 1.0)
        z += gap * L + radius
        place = [aside * L * (number % 2), 0.0, z]
        bodies.append({"position": place, "radius": radius, "mass": M * 10.0 ** (decades * number)})
        z += radius
    document: Document = {
        "body": bodies,
        "time": {"duration": draw.choice(0.3, 0.6) * L / U},
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -U * U / L]},
        "contact": {
            "restitution": draw.choice(0.0, 0.2, 0.5, 0.8),
            "static_friction": draw.choice(0.0, 0.3),
            "timing": draw.choice("auto", "auto", "end-of-step", "time-of-impact"),
        },
        "record": {"every": "step", "check_every": 1},
    }
    if draw.choice(False, True):
        document["plane"] = [{}]
    else:
        for body in bodies:
            body["position"][2] -= 0.5 * z
        document["domain"] = {"boundary": "walls", "size": [2.5 * bodies[-1]["radius"]] * 2 + [z * (1.0 + 1e-9)]}
    if one_in(draw, 4):
        document["time"]["fixed_dt"] = L / U * draw.choice(1e-3, 0.01, 0.05)
    return document


def _groups(draw: Draw, scale: Scales) -> Document:
    """Draw groups of bodies, which carom places; some groups are beside a body or over a plane."""
    document, L = meeting(draw, scale=scale, most_bodies=1), scale.L
    extent = L * draw.choice(6.0, 10.0)
    document["group"] = [_group(draw, scale, extent) for _ in range(draw.choice(1, 1, 2))]
    del document["body"]
    if one_in(draw, 3):
        document["body"] = [
            {"position": row(vector(draw) * extent), "radius": L * draw.choice(0.5, 1.0, 4.0), "mass": scale.M}
        ]
    if "domain" in document:
        document["domain"]["size"] = [4.0 * extent] * 3
    elif one_in(draw, 3):
        document["plane"] = [{"point": [0.0, 0.0, draw.choice(-1.0, -0.5, 0.0) * extent]}]
    return document


def _group(draw: Draw, scale: Scales, extent: float) -> Document:
    """Draw a group in a region of about twice the volume of its bodies."""
    L, U, M = scale
    shape = draw.choice("ball", "box", "cylinder", "shell")
    region: Document = {"shape": shape}
    region |= {"size": [2.0 * extent] * 3} if shape == "box" else {"radius": extent}
    region |= {"cylinder": {"height": extent}, "shell": {"inner_radius": 0.3 * extent}}.get(shape, {})
    group: Document = {
        "count": draw.integer(1, 24),
        "radius": draw.choice(L, L, None) or {"min": 0.5 * L, "max": L},
        "mass": M,
        "region": region,
        "arrangement": draw.choice("random", "random", "cubic", "fcc", "hcp", "compressed"),
        "velocity": {"mean": row(vector(draw) * U), "dispersion": draw.choice(0.0, 1.0) * U},
    }
    if one_in(draw, 2):
        group["spin"] = {"dispersion": U / L}
    if one_in(draw, 4):
        group["bulk_rotation"] = row(vector(draw) * (U / extent))
    return group


def _planets(draw: Draw, scale: Scales) -> Document:
    """Draw a few light bodies on orbits about a heavy one."""
    L, U, M = scale
    constant = U * U * L / M
    bodies: list[Document] = [{"position": [0.0, 0.0, 0.0], "radius": 1e-3 * L, "mass": M}]
    for number in range(draw.integer(1, 4)):
        distance, angle = L * 1.7**number, 2.0 * math.pi * draw.integer(0, 15) / 16
        speed = math.sqrt(constant * M / distance) * draw.choice(1.0, 0.95)
        there = np.array([math.cos(angle), math.sin(angle), 0.0])
        along = np.array([-there[1], there[0], draw.choice(0.0, 0.05)])
        small: Document = {"position": row(distance * there), "velocity": row(speed * along)}
        bodies.append(small | {"radius": 1e-5 * L, "mass": M * decade(draw, -9, -4)})
    time: Document = {
        "duration": draw.choice(1.0, 6.0) * L / U,
        "integrator": draw.choice("auto", "leapfrog", "yoshida4", "gauss-radau15", "wisdom-holman"),
    }
    if time["integrator"] == "wisdom-holman":
        time |= {"fixed_dt": 0.05 * L / U, "encounters": draw.choice("resolve", "ignore")}
    elif one_in(draw, 2):
        time["accuracy"] = draw.choice(1e-4, 1e-8)
    return {
        "body": bodies,
        "time": time | {"max_dt": L / U},
        "gravity": {"constant": constant},
        "contact": {"enabled": draw.choice(False, True)},
        "record": {"every": "step"},
    }
