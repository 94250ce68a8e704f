"""Statements of data files about gravity, time and box, compared with the scene and with each other."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

import numpy as np

from carom.scene.data import MotionLaw
from carom.scene.data.body_sources import SourcedBodies
from carom.scene.data.facts import Facts, FileBox, contradiction
from carom.scene.scene_model import SceneModel
from carom.scene.units.dimension import GRAVITATIONAL_CONSTANT, LENGTH, TIME
from carom.scene.units.system import UnitSystem

LAW = {"constant": GRAVITATIONAL_CONSTANT, "softening": LENGTH}  # keys of [gravity] that a file may state
_SAME_LAW = 1e-9  # relative difference that the number of written digits may cause


def take_over_laws(
    scene: SceneModel, units: UnitSystem, given: Mapping[str, Any], each_bodies: list[SourcedBodies]
) -> tuple[dict[str, float], dict[int, str]]:
    """Compare the laws of motion in the files with the scene; add notes to the bodies in ``each_bodies``.

    Parameters
    ----------
    given
        The section [gravity] as written.

    Returns
    -------
    taken, refuted
        Plain numbers for keys of [gravity] that a file states but the scene does not; and contradictions between a file
        and the scene or another file, by the index of the file's [[bodies]] table.
    """
    is_off = scene.gravity.method == "none" or ("constant" in given and scene.gravity.constant == 0.0)
    taken, refuted = dict[str, float](), dict[int, str]()
    for index, bodies in enumerate(each_bodies):
        law, notes = bodies.law, list[str]()
        if law is None:
            continue
        if is_off and law.constant > 0.0:
            notes.append(f"G = {law.constant:g} is not used, because the scene has no gravity between bodies")
        for key, dimension in () if is_off else LAW.items():
            number = float(getattr(law, key))
            if key not in given and key not in taken and (number > 0.0 or key == "constant"):
                taken[key] = number
            own = taken.get(key, units.shown(getattr(scene.gravity, key), dimension))
            if taken.get(key) == number:
                notes.append(f"gravity.{key} = {number:g} is taken from the file")
            elif number == 0.0 and key == "softening" and own > 0.0:
                notes.append(f"it has no softening, but the scene has {own:g}")
            elif not math.isclose(own, number, rel_tol=_SAME_LAW):
                remedy = f"leave gravity.{key} out, or set that"
                refuted[index] = f"gravity.{key} is {number!r} in it, but {own!r} here; {remedy}"
        x, y, z = law.ghosts
        images = f"N_ghost_x, N_ghost_y, N_ghost_z = {x}, {y}, {z}"
        if law.constant > 0.0 and not is_off and any(law.ghosts):
            copies = f"{2 * x + 1} × {2 * y + 1} × {2 * z + 1} copies"
            refuted.setdefault(
                index,
                f"{images}: each of its particles attracts {copies} of the others, but here each body once; set "
                "gravity.constant = 0, or N_ghost_x = N_ghost_y = N_ghost_z = 0 in REBOUND",
            )
        elif law.collides and scene.contact.enabled and _differs_in_ghosts(law, bodies.facts):
            notes.append(
                f"{images}: its bodies meet those many copies of each other, but here the nearest copy in a periodic "
                "box, and none in open space"
            )
        if law.integrated and scene.time.integrator != (law.integrator or None):
            known = f'time.integrator = "{law.integrator}" is this method'
            notes.append(
                f"{law.integrated} is not taken over; {known if law.integrator else 'carom lacks this method'}"
            )
        if not law.collides and scene.contact.enabled:
            notes.append("its bodies pass through each other; contact.enabled = false does the same here")
        _add_notes(scene, index, each_bodies, notes)
    return taken, refuted


def compare_facts(scene: SceneModel, units: UnitSystem, each_bodies: list[SourcedBodies]) -> dict[int, str]:
    """Compare the files' statements with the scene and with each other; add notes to the bodies in ``each_bodies``.

    Return contradictions by the index of the [[bodies]] table.
    """
    refuted = dict[int, str]()
    for index, bodies in enumerate(each_bodies):
        for before in range(index):
            other = scene.bodies[before].called
            if differs := contradiction(bodies.facts, other, each_bodies[before].facts):
                refuted.setdefault(index, differs)
            now, then = bodies.facts.time, each_bodies[before].facts.time
            if now is not None and then is not None and not math.isclose(now, then, rel_tol=_SAME_LAW):
                note = f"its time is {units.text(now, TIME)}, and the time of {other} is {units.text(then, TIME)}"
                _add_notes(scene, index, each_bodies, [note])
        box = bodies.facts.box
        if box is None:
            continue
        low, size = ([units.shown(each, LENGTH) for each in values] for values in (box.low, box.size))
        shown = " × ".join(f"{each:g}" for each in size)
        own = scene.domain.size or (0.0, 0.0, 0.0)
        alike = [math.isclose(a, b, rel_tol=_SAME_LAW) for a, b in zip(own, box.size, strict=True)]
        open_axes = [axis for k, axis in enumerate("xyz") if axis in box.periodic and k not in scene.domain.repeating]
        if bodies.law is not None and box.periodic and (open_axes or not all(alike)):
            refuted[index] = (
                f'its box is periodic; set domain.boundary = "periodic" and domain.size = '
                f"[{', '.join(f'{each:g}' for each in size)}]"
            )
        elif open_axes:
            wanted = '"periodic"' if box.periodic == "xyz" else _quoted_axes(box)
            along = "" if box.periodic == "xyz" else f" along {' and '.join(box.periodic)}"
            note = f"its box of {shown} is periodic{along}, which is ignored; set domain.boundary = {wanted} for that"
            _add_notes(scene, index, each_bodies, [note])
        elif any(axis in box.periodic and not same for axis, same in zip("xyz", alike, strict=True)):
            mine = " × ".join(f"{units.shown(each, LENGTH):g}" for each in own)
            _add_notes(scene, index, each_bodies, [f"its periodic box is {shown}, and domain.size is {mine}"])
        # bodies lie beyond the walls if the program has its box elsewhere
        half = 0.5 * np.array(own)
        beyond: list[bool] = np.any(np.abs(bodies.columns.position) > half, axis=0).tolist()
        if any(beyond[axis] for axis in scene.domain.walled) and scene.bodies[index].origin is None:
            middle = [a + 0.5 * b for a, b in zip(low, size, strict=True)]
            ends = [f"{a:g} to {a + b:g}" for a, b in zip(low, size, strict=True)]
            refuted[index] = (
                f"its box is {' × '.join(ends)}, and the walls of domain are about the origin; write origin = "
                f"[{', '.join(f'{each:g}' for each in middle)}] in [[bodies]]"
            )
    return refuted


def _quoted_axes(box: FileBox) -> str:
    """Return the boundary along each axis as a list for a scene."""
    return str(["periodic" if axis in box.periodic else "open" for axis in "xyz"]).replace("'", '"')


def _add_notes(scene: SceneModel, index: int, each_bodies: list[SourcedBodies], notes: Iterable[str]) -> None:
    """Add notes to the bodies of a table; a changed scene already has its earlier notes."""
    bodies, called = each_bodies[index], scene.bodies[index].called
    new = [f"{called}: {note}" for note in notes]
    each_bodies[index] = bodies._replace(notes=(*bodies.notes, *(note for note in new if note not in bodies.notes)))


def _differs_in_ghosts(law: MotionLaw, facts: Facts) -> bool:
    """Return whether bodies meet across the faces of the box only in REBOUND, or only in carom."""
    return any(law.ghosts) if facts.box is None else not all(law.ghosts)
