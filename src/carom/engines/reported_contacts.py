"""Laws for the contacts that an engine reports: no pull, no friction along the slip, no friction above μ N."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from carom.arrays import FloatArray, Records
from carom.engines.elastic_energy import TINY
from carom.engines.engine_contacts import EngineMoment, cross, lengths
from carom.engines.faults import FRICTION, PULL, Broken
from carom.engines.single_contacts import IMPULSIVE, RUBBED
from carom.engines.source import Setup


def judge_reported(
    setup: Setup, contacts: Records, before: EngineMoment, now: EngineMoment, friction: float, slow: float
) -> Iterator[Broken]:
    """Yield the laws that reported contacts, (m,) `CONTACT`, break between two moments.

    ``friction`` is the fraction of the work of friction that may have the wrong sign, and ``slow`` is the largest speed
    (m/s) of contacts at rest. Friction counts as acting along the slip only if it acts along the slip before and after
    the step, since an engine may have computed contacts at either time.
    """
    dt = now.time - before.time
    i, j = contacts["i"], contacts["j"]
    judged = np.append(setup.judged, np.ones(len(setup.planes), bool))
    if not len(contacts) or not dt > 0.0:
        return
    ease = np.append(np.where(setup.fixed, 0.0, 1.0 / setup.mass), np.zeros(len(setup.planes)))
    push, rubs = contacts["force"], lengths(contacts["friction"])
    least = slow / np.maximum((ease[i] + ease[j]) * dt, TINY)  # N, largest force that a contact at rest may have
    allowed = IMPULSIVE * (np.abs(push).max() + least)
    known = judged[i] & judged[j] & (ease[i] + ease[j] > 0.0)
    for k in np.flatnonzero(known & (push < -allowed)).tolist():
        what = "pull each other in the engine's own contacts: a contact can only push"
        yield Broken(PULL, float(-push[k] / allowed[k]), _ends(contacts, k), what)
    if setup.friction is not None:
        beyond = rubs - setup.friction * np.maximum(push, 0.0)
        for k in np.flatnonzero(known & (beyond > allowed)).tolist():
            ratio = rubs[k] / max(push[k], TINY)
            what = f"rub with {ratio:.3g} times their normal force in the engine's own contacts; "
            what += f"the model says {setup.friction:.3g}"
            yield Broken(FRICTION, float(beyond[k] / allowed[k]), _ends(contacts, k), what)
    if not setup.spins:
        return
    slips = [_slip(setup, contacts, moment) for moment in (before, now)]
    works = [np.einsum("ij,ij->i", contacts["friction"], slip) for slip in slips]
    least_works = [rubs * (friction * lengths(slip) + slow) for slip in slips]
    # if a body has another contact, the friction of a soft contact also resists the acceleration by that contact
    beside = np.bincount(np.concatenate((i, j)), minlength=len(ease)) > 1
    beside[len(setup) :] = False
    known = known & ~beside[i] & ~beside[j]
    with_slip = (works[0] > least_works[0]) & (works[1] > least_works[1]) & (rubs > RUBBED * np.abs(push) + allowed)
    for k in np.flatnonzero(known & with_slip).tolist():
        excess = min(float(work[k] / most[k]) for work, most in zip(works, least_works, strict=True))
        what = "rub with the slip in the engine's own contacts: the friction adds energy"
        yield Broken(FRICTION, excess, _ends(contacts, k), what)


def _ends(contacts: Records, k: int) -> tuple[int, int]:
    i, j = int(contacts["i"][k]), int(contacts["j"][k])
    return min(i, j), max(i, j)


def _slip(setup: Setup, contacts: Records, moment: EngineMoment) -> FloatArray:
    """Return the tangential velocities (m, 3) of the second ends' surfaces relative to the first ends' surfaces."""
    normal = contacts["normal"]
    slip = np.zeros((len(contacts), 3))
    for end, sign, out in (("i", -1.0, 1.0), ("j", 1.0, -1.0)):
        body = contacts[end]
        moves = body < len(setup)
        own = body[moves]
        arm = out * setup.radius[own][:, None] * normal[moves]
        slip[moves] += sign * (moment.velocity[own] + cross(moment.spin[own], arm))
    return np.asarray(slip - np.einsum("ij,ij->i", slip, normal)[:, None] * normal)
