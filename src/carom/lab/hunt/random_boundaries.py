"""Random scenes of bodies inside boundaries: walls of every shape and motion, pistons, sheared boxes, and pours.

A few bodies, slow or fast, fill a small lattice in the middle, with and without a field, under a random contact law.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from carom.lab.hunt.documents import Document, Draw, Scales, decade, direction, fraction, one_in, row, vector

SPEEDS = (1e-3, 0.1, 1.0, 5.0)  # speeds of the bodies, in units of the scene's speed
PITCH = (2.01, 2.5)  # distances of neighbours on the lattice, in radii
ROOM = 1.8  # extent of a boundary, relative to the extent of the bodies
CROSSINGS = 3.0  # number of radii that a body crosses in a run at the scene's speed


def enclosed(draw: Draw, scale: Scales) -> Document:
    """Draw bodies inside a hollow, on a plate, in a funnel, under a piston, or in a sheared box."""
    document = draw.choice(_in_a_hollow, _in_a_hollow, _on_plates, _in_a_funnel, _under_a_piston, _sheared)(draw, scale)
    _choose_law(draw, document["contact"], scale)
    return document


def _scene(draw: Draw, scale: Scales, *, falls: bool | None = None) -> tuple[Document, float]:
    """Draw bodies about the origin; return their scene, and the radius of the ball that contains them."""
    L, U, M = scale
    side, pitch = draw.choice(1, 2, 2, 3), L * draw.choice(*PITCH)
    speed, spins = U * draw.choice(*SPEEDS), draw.choice(False, True)
    bodies: list[Document] = []
    for index in range(min(draw.integer(1, 8), side**3)):
        place = np.array([index % side, index // side % side, index // side**2]) - 0.5 * (side - 1)
        body: Document = {"position": row(pitch * place), "radius": L, "mass": M * draw.choice(1.0, 1.0, 1e-3, 30.0)}
        body["velocity"] = row(speed * vector(draw))
        if spins:
            body["angular_velocity"] = row(vector(draw) * (speed / L))
        bodies.append(body)
    friction = draw.choice(0.0, 0.3, 1.0)
    document: Document = {
        "body": bodies,
        "time": {"duration": CROSSINGS * L / U * draw.choice(0.3, 1.0)},
        "gravity": {"constant": 0.0},
        "contact": {
            "restitution": draw.choice(1.0, 1.0, fraction(draw)),
            "static_friction": friction,
            "kinetic_friction": friction * draw.choice(1.0, 0.5),
        },
        "record": {"every": "step", "check_every": 1},
    }
    if one_in(draw, 2) if falls is None else falls:
        document["gravity"]["uniform"] = row(direction(draw) * (decade(draw, -1, 1) * U * U / L))
    if one_in(draw, 4):
        document["contact"]["timing"] = draw.choice("time-of-impact", "end-of-step")
    return document, 0.5 * np.sqrt(3.0) * (side - 1) * pitch + L


def _motion(draw: Draw, scale: Scales, *, turns: bool) -> Document:
    """Draw the motion of a wall: none, a rotation, a translation, an oscillation, or changing velocities."""
    L, U = scale.L, scale.U
    kind = draw.integer(0, 5)
    if kind == 0 and turns:
        return {"motion": {"rotation": draw.choice(-1.0, 0.1, 3.0) * U / L}}
    if kind == 1:
        return {"motion": {"velocity": row(vector(draw) * (0.1 * U) + np.array([0.01 * U, 0.0, 0.0]))}}
    if kind == 2:
        way = direction(draw) * (0.05 * L)
        return {"motion": {"amplitude": row(way), "frequency": draw.choice(0.3, 3.0) * U / L}}
    if kind == 3:
        velocities = [row(vector(draw) * (0.2 * U)), [0.0, 0.0, 0.0]]
        return {"motion": {"times": [0.1 * L / U, 0.5 * L / U], "velocities": velocities}}
    return {}


def _in_a_hollow(draw: Draw, scale: Scales) -> Document:
    document, reach = _scene(draw, scale)
    radius = ROOM * reach * draw.choice(1.0, 3.0)
    if one_in(draw, 2):
        document["wall"] = [{"sphere": {"radius": radius}} | _motion(draw, scale, turns=True)]
        return document
    axis = direction(draw)
    document["wall"] = [{"cylinder": {"radius": radius, "axis": row(axis)}} | _motion(draw, scale, turns=True)]
    if one_in(draw, 2):  # a drum
        ends = [{"point": row(sign * ROOM * reach * axis), "normal": row(-sign * axis)} for sign in (-1.0, 1.0)]
        document["plane"] = ends
    return document


def _on_plates(draw: Draw, scale: Scales) -> Document:
    """Draw a disc or rectangle below the bodies (along the field, if there is one), and perhaps another beside them."""
    document, reach = _scene(draw, scale)
    field = np.array(document["gravity"].get("uniform", [0.0, 0.0, -1.0]))
    normal = -field / np.sqrt((field * field).sum())
    one = np.cross(normal, [1.0, 0.0, 0.0] if abs(normal[0]) < 0.9 else [0.0, 1.0, 0.0])
    one /= np.sqrt((one * one).sum())
    other = np.cross(normal, one)
    centre = -(reach + draw.choice(1e-3, 0.3) * scale.L) * normal
    size = 2.0 * reach * draw.choice(0.5, 2.0)
    if one_in(draw, 2):
        wall: Document = {"disc": {"radius": size, "centre": row(centre), "normal": row(normal)}}
        document["wall"] = [wall | _motion(draw, scale, turns=True)]
    else:
        sides = {"side": row(size * one), "other_side": row(size * other)}
        document["wall"] = [{"rectangle": {"centre": row(centre), **sides}} | _motion(draw, scale, turns=False)]
    if one_in(draw, 3):
        document["wall"].append({"disc": {"radius": size, "centre": row(ROOM * reach * one), "normal": row(one)}})
    return document


def _in_a_funnel(draw: Draw, scale: Scales) -> Document:
    document, reach = _scene(draw, scale)
    field = np.array(document["gravity"].get("uniform", [0.0, 0.0, -1.0]))
    axis = -field / np.sqrt((field * field).sum())
    height = 4.0 * reach
    cone = {
        "radius": scale.L * draw.choice(0.0, 0.9, 1.5),
        "end_radius": 4.0 * reach,
        "height": height,
        "point": row(-2.0 * reach * axis),
        "axis": row(axis),
    }
    document["wall"] = [{"cone": cone} | _motion(draw, scale, turns=True)]
    return document


def _under_a_piston(draw: Draw, scale: Scales) -> Document:
    """Draw a box of walls whose top is a piston."""
    document, reach = _scene(draw, scale, falls=False)
    L, U, M = scale
    width, height = ROOM * reach, 2.0 * reach * draw.choice(1.0, 2.0)
    if one_in(draw, 2):
        document["gravity"]["uniform"] = [0.0, 0.0, -decade(draw, -1, 1) * U * U / L]
    piston: dict[str, Any] = {"mass": M * draw.choice(0.1, 3.0, 100.0), "force": M * U * U / L * decade(draw, -1, 1)}
    if one_in(draw, 2):
        piston["velocity"] = U * draw.choice(-0.1, 0.3)
    document["domain"] = {"boundary": ["walls", "walls", "open"], "size": [2.0 * width, 2.0 * width, 4.0 * height]}
    document["plane"] = [
        {"point": [0.0, 0.0, -reach * 1.001]},
        {"point": [0.0, 0.0, height], "normal": [0.0, 0.0, -1.0], "piston": piston},
    ]
    document["contact"].pop("timing", None)
    return document


def _sheared(draw: Draw, scale: Scales) -> Document:
    document, reach = _scene(draw, scale, falls=False)
    document["domain"] = {
        "boundary": "periodic",
        "size": row(np.array([2.0, 2.5, 3.0]) * (ROOM * reach)),
        "shear": {"rate": scale.U / scale.L * draw.choice(0.03, 1.0, -0.3), "flow": "x", "gradient": "y"},
    }
    return document


def poured(draw: Draw, scale: Scales) -> Document:
    """Draw bodies that enter above a slope or a funnel, and perhaps leave and come back."""
    L, U, M = scale
    height, count = 6.0 * L, draw.integer(1, 12)
    room = L * draw.choice(2.1, 5.0, 9.0)  # if fewer bodies fit than enter, some wait
    release = draw.choice({"at": 0.2 * L / U}, {"rate": 2.0 * U / L}, {"rate": 0.5 * U / L, "at": L / U})
    if one_in(draw, 3):
        release = release | {"until": 5.0 * L / U}
    friction = draw.choice(0.0, 0.3, 1.0)
    document: Document = {
        "time": {"duration": draw.choice(3.0, 12.0) * L / U},
        "gravity": {"constant": 0.0, "uniform": [0.0, 0.0, -decade(draw, -1, 0) * U * U / L]},
        "contact": {
            "restitution": draw.choice(1.0, fraction(draw)),
            "static_friction": friction,
            "kinetic_friction": friction * draw.choice(1.0, 0.5),
        },
        "group": [
            {
                "count": count,
                "radius": draw.choice(L, {"min": 0.5 * L, "max": L}),
                "mass": M,
                "region": {"shape": "box", "size": [room, room, room], "centre": [0.0, 0.0, height + 0.5 * room]},
                "velocity": {"mean": [0.0, 0.0, -U], "dispersion": draw.choice(0.0, 0.1) * U},
                "release": release,
            }
        ],
        "record": {"every": "step", "check_every": 1},
    }
    if one_in(draw, 2):
        cone = {"radius": L * draw.choice(1.2, 2.5), "end_radius": height, "height": 0.5 * height}
        document["wall"] = [{"cone": cone | {"point": [0.0, 0.0, 0.3 * height]}}]
    else:
        document["plane"] = [{"normal": [draw.choice(0.0, 0.3), 0.0, 1.0]}]
    places: dict[str, Document] = {
        "below": {"point": [0.0, 0.0, draw.choice(0.0, 0.2) * height]},
        "middle": {"region": {"shape": draw.choice("ball", "shell"), "radius": 2.0 * L, "centre": [0.0, 0.0, 3.0 * L]}},
        "beside": {"point": [2.0 * L, 0.0, 0.0], "normal": [-1.0, 0.0, 0.0]},
    }
    for outlet in draw.choice((), ("below",), ("middle",), ("beside",), ("below", "beside")):
        place = places[outlet]
        if place.get("region", {}).get("shape") == "shell":
            place["region"]["inner_radius"] = L
        document.setdefault("outlet", []).append(place | {"to": draw.choice("inlet", "out")})
    _choose_law(draw, document["contact"], scale)
    return document


def _choose_law(draw: Draw, contact: Document, scale: Scales) -> None:
    """Choose the contact law: Coulomb's in half of the scenes."""
    U, name = scale.U, draw.choice("viscoelastic", "power_law", "restitution_table", "walton", "rolling_resistance")
    if one_in(draw, 2):
        return
    contact["law"] = name
    contact[name] = {
        "rolling_resistance": {"rolling_friction": draw.choice(0.0, 0.1), "twisting_friction": draw.choice(0.0, 0.1)},
        "viscoelastic": {"restitution": 0.8, "speed": U},
        "power_law": {"restitution": 0.9, "speed": 0.1 * U, "exponent": 0.25},
        "restitution_table": {"speeds": [0.01 * U, U], "restitutions": [0.9, 0.5]},
        "walton": {"tangential_restitution": draw.choice(0.0, 0.4)},
    }[name]
