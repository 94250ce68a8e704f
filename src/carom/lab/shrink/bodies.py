"""Leaves out bodies: first all but those that the failure may come from, then as many as delta debugging can."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carom.lab.shrink.delta_debugging import fewest
from carom.lab.shrink.literal import BODIES, ORIGIN, Document, with_bodies
from carom.lab.shrink.observation import Observation
from carom.lab.shrink.smallest import Smallest
from carom.lab.shrink.trials import Trials, observe
from carom.physics.frame import Frame
from carom.physics.schedule import every
from carom.physics.space import Space

Met = tuple[int, int]  # bodies that touched in a step


def leave_out_bodies(smallest: Smallest, trials: Trials) -> bool:
    """Leave out bodies; tell whether any was."""
    before = smallest.bodies
    _keep_the_cone(smallest, trials)
    base = smallest.document
    fewest(range(smallest.bodies), lambda parts: smallest.takes_first([with_bodies(base, part) for part in parts]))
    return smallest.bodies < before


def _keep_the_cone(smallest: Smallest, trials: Trials) -> None:
    """Keep the bodies in question, those from which contacts lead to them, or those nearby; the fewest first."""
    names = [body["name"] for body in smallest.document[BODIES]]
    suspects = {number for number, name in enumerate(names) if name in smallest.suspects}
    if not suspects or len(suspects) == len(names):
        return
    base = smallest.document
    for kept in (*cones(suspects, _contacts(smallest, trials), len(names)), *_nearest(suspects, base)):
        if smallest.takes(with_bodies(base, sorted(kept))):
            return


def _nearest(bodies: set[int], document: Document) -> Iterator[set[int]]:
    """Yield the bodies with some of the nearest others, and then with ever more."""
    position = np.array([body.get("position", ORIGIN) for body in document[BODIES]])  # (n, 3) m
    distance = np.linalg.norm(position[:, None] - position[sorted(bodies)][None], axis=2).min(axis=1)
    order = np.argsort(distance, kind="stable")
    size = len(bodies) + 4
    while size < len(order) // 2:
        yield set(order[:size].tolist())
        size *= 2


def cones(bodies: set[int], steps: list[list[Met]], count: int) -> Iterator[set[int]]:
    """Yield the bodies, then also those that touched them, and so on; last those of the whole backward cone.

    Parameters
    ----------
    bodies
        Numbers of bodies.
    steps
        The pairs that touched in each step, in order of time.
    count
        Number of all bodies; planes, whose numbers follow, have no cone.
    """
    yield set(bodies)
    every_pair = [pair for step in steps for pair in step if max(pair) < count]
    once = bodies | {end for pair in every_pair if bodies & set(pair) for end in pair}
    if once != bodies:
        yield once
    cone = set(bodies)
    for step in reversed(steps):
        size = -1
        while size != len(cone):  # contacts of one step act on each other
            size = len(cone)
            cone |= {end for pair in step if max(pair) < count and cone & set(pair) for end in pair}
    if cone != once and len(cone) < count:
        yield cone


def _contacts(smallest: Smallest, trials: Trials) -> list[list[Met]]:
    """Run the smallest scene and return the pairs that touched in each step."""
    met: list[list[Met]] = []

    def see(seen: Observation, frame: Frame) -> bool:
        rows = [rows for rows in (frame.impacts, frame.contact_rows) if rows is not None]
        met.append([(int(row["i"]), int(row["j"])) for table in rows for row in table])
        return True

    space = Space(smallest.scene, threads=1, record_contacts=True)
    observe(space, trials.budget, see, schedule=every(0.0))
    return met
