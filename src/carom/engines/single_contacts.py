"""Laws of single contacts, judged from two states: friction, restitution, pull and spin.

If the bodies that may have touched between two frames form a tree of at most `MOST` contacts, the impulse of each
contact follows from the momenta, because a leaf of the tree has one unknown impulse. The engine may have resolved the
contacts in any order, with the positions of either frame, and the field may have acted before or after the contacts. A
law is reported as broken only if every possible order and normal breaks it.

At the end of the run, rebounds, torques and friction are also compared between all contacts of the run.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.engines.contact_torques import ContactTorque, ContactTorques
from carom.engines.elastic_energy import PARTED
from carom.engines.engine_contacts import MARGIN, EngineMoment, Near, cross, lengths, rotated
from carom.engines.faults import FRICTION, PULL, RESTITUTION, SPIN, Broken, BrokenThen
from carom.engines.missed_impacts import SHALLOW
from carom.engines.rebounds import IsolatedImpact, Rebounds
from carom.engines.rubbing_contacts import RubbingContacts
from carom.engines.source import Setup
from carom.physics.contact.islands import number_sets

MOST = 3  # largest number of contacts in a tree; four have 24 orders, one of which would explain nearly any outcome
IMPULSIVE = 0.02  # relative error of a contact's impulse; engines that correct positions add about 1 %
DAMPED = 2e-3  # fraction of m |v| that an engine's damping may take in a frame: PyBullet takes 0.07 %
RUBBED = 0.02  # smallest judged ratio of friction to a contact's impulse, beyond the rotation of the normal
SPUN = 0.1  # allowed error of a torque, relative to r |J_t|
WAYS = 6  # variants for an isolated contact: three normals, and the field before or after it
KEPT = 0.25  # fraction of J_n times the gain of speed; friction may dissipate as much as the contact keeps


@dataclass(frozen=True, slots=True)
class Measurement:
    """Measured quantities of one contact: a value for each order of the contacts and each possible normal, (m,)."""

    closing: FloatArray  # m/s, closing speed of the surfaces before the frame
    parting: FloatArray  # m/s, speed of separation after the frame
    slip: FloatArray  # m/s, tangential velocity after the frame
    normal: FloatArray  # N s, normal impulse on the second end
    tangential: FloatArray  # N s, tangential impulse
    lost: FloatArray  # J
    point: FloatArray  # (3,) m
    direction: FloatArray  # (3,) unit vector from the first end to the second
    least: float  # N s, largest impulse that may come from damping
    ease: float  # 1/kg, change of the closing speed per normal impulse


class ContactLaws:
    """Judges the contacts between successive frames of one set of bodies."""

    def __init__(self, setup: Setup, restitution: float, friction: float) -> None:
        self._setup = setup
        self.restitution = restitution  # allowed error of a coefficient of restitution
        self.coefficient = setup.friction
        self.friction = friction  # work of the wrong sign that friction may do, divided by |J_t| times the slip
        self.rebounds = Rebounds(setup, restitution)
        self.torques = ContactTorques()
        self.slides = RubbingContacts()

    def see(
        self, step: int, before: EngineMoment, now: EngineMoment, near: Near, closing: FloatArray, still: float
    ) -> list[Broken]:
        """Judge the contacts between two moments, given earlier closing speeds and the speed of slow contacts, m/s."""
        dt = now.time - before.time
        self.rebounds.settle(step, before, now, dt)
        if self._setup.constant or not dt > 0.0 or not self._setup.touches.any():
            return []
        fall, after = self._setup.field_strength * dt, near.closing_now
        found: list[Broken] = []
        trees = list(trees_of(self._setup, near, closing, dt))
        isolated = np.array([tree[0] for tree in trees if len(tree) == 1], dtype=np.int64)
        self.slides.see((step, now.time), self._setup, (before, now), near, isolated, closing, still)
        for tree in trees:
            if (closing[tree] > still).any() or (after[tree] < -still).any():
                found += ContactTree(self._setup, before, now, near, tree).judge(
                    self, step, now.time, still + 2.0 * fall
                )
        return found

    def concluded(self) -> Iterator[BrokenThen]:
        """Yield the broken laws, judged by all contacts of the run."""
        yield from self.rebounds.concluded()
        yield from self.torques.concluded()
        yield from self.slides.concluded(len(self._setup))

    def go_on(self, earlier: ContactLaws) -> None:
        """Drop the unfinished impacts of an earlier set of bodies, which have other numbers."""
        if len(earlier._setup) == len(self._setup):
            self.rebounds.impacts, self.torques, self.slides = earlier.rebounds.impacts, earlier.torques, earlier.slides


def trees_of(setup: Setup, near: Near, closing: FloatArray, dt: float) -> Iterator[IntArray]:
    """Yield the rows of each set of near pairs that may have touched in a frame of dt s and have known impulses.

    Each set is a tree of at most `MOST` contacts with at most one fixed end. ``closing`` are earlier closing speeds,
    (k,) m/s.
    """
    fall, after = setup.field_strength * dt, near.closing_now
    reach = np.minimum(
        np.minimum(near.gap_before, near.gap_now),
        np.minimum(near.gap_before - np.maximum(closing, 0.0) * dt, near.gap_now + np.minimum(after, 0.0) * dt),
    )
    touching = np.flatnonzero(reach <= MARGIN * near.small + fall * dt)
    n, pairs = len(setup), near.pairs[touching]
    loose = np.append(~setup.fixed, np.zeros(len(setup.planes), bool))
    known = np.append(setup.judged & setup.touches, np.ones(len(setup.planes), bool))
    i, j = pairs.T
    both = loose[i] & loose[j]
    label = np.empty(n, np.int64)
    count = number_sets(i[both], j[both], label)
    owner = label[np.where(loose[i], i, np.minimum(j, n - 1))]
    contacts, anchors = np.bincount(owner, minlength=count), np.bincount(owner, ~both, count)
    strange = np.bincount(owner, ~(known[i] & known[j]), count) + np.bincount(owner, ~(loose[i] | loose[j]), count)
    is_tree = (contacts - anchors == np.bincount(label, minlength=count) - 1) & (anchors <= 1)
    order = np.argsort(owner, kind="stable")
    for chosen in np.flatnonzero(is_tree & (contacts > 0) & (contacts <= MOST) & (strange == 0)).tolist():
        begin, end = np.searchsorted(owner[order], [chosen, chosen + 1])
        yield touching[order[begin:end]]


class ContactTree:
    """A tree of contacts between two moments, and the impulse of each contact."""

    def __init__(self, setup: Setup, before: EngineMoment, now: EngineMoment, near: Near, rows: IntArray) -> None:
        n, dt = len(setup), now.time - before.time
        self._near, self._rows, self._dt = near, rows, dt
        self._place_in_time = 0, 0.0  # step and time in s
        ends = near.pairs[rows]
        bodies = np.unique(ends[ends < n])
        place = {int(body): k for k, body in enumerate(bodies)}
        self._bodies = bodies
        self._ends = [(place[int(i)], place.get(int(j), -1)) for i, j in ends]
        self._pairs = [(int(i), int(j)) for i, j in ends]
        fixed = setup.fixed[bodies]
        self._place = now.position[bodies]
        self._weight = np.where(fixed, 0.0, 1.0 / setup.mass[bodies])
        self._ease = np.where(fixed, 0.0, 1.0 / setup.inertia[bodies])
        self._radius, self._spins = setup.radius[bodies], setup.spins and len(now.spin) > 0
        still = np.zeros((len(bodies), 3))
        self._v0 = before.velocity[bodies]
        self._v1 = now.velocity[bodies]
        self._w0, self._w1 = (before.spin[bodies], now.spin[bodies]) if self._spins else (still, still)
        self._turned_spins: FloatArray | None = None  # rad/s, changes of spins measured in body frames
        if self._spins and len(now.orientation):
            real = [rotated(moment.orientation[bodies], moment.spin[bodies]) for moment in (before, now)]
            self._turned_spins = real[1] - real[0]
        self._field = np.where(fixed, 0.0, 1.0)[:, None] * setup.gravity * dt
        momentum = (self._v1 - self._v0 - self._field) / np.where(fixed, 1.0, self._weight)[:, None]
        momentum[fixed] = 0.0
        self.impulses = self._solve(momentum, self._weight > 0.0)
        speed = np.maximum(lengths(self._v0), lengths(self._v1))
        self._noise = DAMPED * float((speed * np.where(fixed, 0.0, setup.mass[bodies])).sum())
        # engines with substeps keep a contact's normal and arms although bodies turn and move
        self._rolled = np.maximum(lengths(self._w0), lengths(self._w1)) * dt
        self._depth = np.maximum(-np.minimum(near.gap_before, near.gap_now)[rows], 0.0)
        self._normals = near.possible_normals(rows)
        _, earlier, present = self._normals
        self._turned = lengths(present - earlier)

    def _solve(self, momentum: FloatArray, loose: BoolArray) -> FloatArray:
        """Return the impulse on the second end of each contact, (k, 3) N s, from the leaves of the tree inwards."""
        left, found = momentum.copy(), np.zeros((len(self._ends), 3))
        open_ = set(range(len(self._ends)))
        while open_:
            for k in sorted(open_):
                leaf = next((b for b in self._ends[k] if b >= 0 and loose[b] and self._degree(b, open_) == 1), None)
                if leaf is None:
                    continue
                i, j = self._ends[k]
                found[k] = left[leaf] if leaf == j else -left[leaf]
                left[i] += found[k]
                if j >= 0:
                    left[j] -= found[k]
                open_.discard(k)
                break
            else:
                break
        return found

    def _degree(self, body: int, contacts: set[int]) -> int:
        return sum(body in self._ends[k] for k in contacts)

    def judge(self, laws: ContactLaws, step: int, time: float, slow: float) -> list[Broken]:
        """Return the laws that the contacts of the tree broke, and note their impacts."""
        self._place_in_time = step, time
        found = [broken for k in range(len(self._rows)) for broken in self._contact(k, laws, slow)]
        for k in range(len(self._rows)) if not found else ():
            if (impact := self._impact(k, step, time, slow)) is not None:
                found += laws.rebounds.note(impact)
        return [*found, *self._torques(laws)]

    def _states(self, k: int, normal: FloatArray) -> Iterator[tuple[FloatArray, FloatArray]]:
        """Yield velocities of the second surface relative to the first before and after contact k, in each order."""
        others = [other for other in range(len(self._rows)) if other != k]
        for share in (0.0, 1.0):
            for size in range(len(others) + 1):
                for done in combinations(others, size):
                    v, w = self._v0 + share * self._field, self._w0.copy()
                    for other in done:
                        self._push(other, normal[other], v, w)
                    first = self._slip(k, normal[k], v, w)
                    self._push(k, normal[k], v, w)
                    yield first, self._slip(k, normal[k], v, w)
            if others:  # in case all contacts are resolved at once, by a solver with one target for each
                v, w = self._v0 + share * self._field, self._w0.copy()
                first = self._slip(k, normal[k], v, w)
                for other in range(len(self._rows)):
                    self._push(other, normal[other], v, w)
                yield first, self._slip(k, normal[k], v, w)

    def measured(self, k: int) -> Measurement:
        """Return the quantities of contact k that the states determine."""
        J, (i, j), found = self.impulses[k], self._ends[k], list[tuple[float, ...]]()
        size = float(J @ J)
        for normals in self._normals:
            n = normals[k]
            along = float(J @ n)
            rubbed = float(np.sqrt(max(size - along * along, 0.0)))
            for u0, u1 in self._states(k, normals):
                parting = float(u1 @ n)
                slip = float(np.sqrt(max(float(u1 @ u1) - parting * parting, 0.0)))
                found.append((-float(u0 @ n), parting, slip, along, rubbed, -0.5 * float(J @ (u0 + u1))))
        closing, parting, slips, normal, tangential, lost = np.array(found).T
        direction = self._normals[0][k]
        point = self._place[i] + (self._radius[i] - 0.5 * self._depth[k]) * direction
        ease = float(self._weight[i] + (self._weight[j] if j >= 0 else 0.0))
        return Measurement(closing, parting, slips, normal, tangential, lost, point, direction, self._noise, ease)

    def _push(self, k: int, n: FloatArray, v: FloatArray, w: FloatArray) -> None:
        (i, j), impulse = self._ends[k], self.impulses[k]
        turn = cross(n, impulse)
        v[i] -= self._weight[i] * impulse
        w[i] -= self._ease[i] * self._radius[i] * turn
        if j >= 0:
            v[j] += self._weight[j] * impulse
            w[j] -= self._ease[j] * self._radius[j] * turn

    def _slip(self, k: int, n: FloatArray, v: FloatArray, w: FloatArray) -> FloatArray:
        i, j = self._ends[k]
        slip = -v[i] - self._radius[i] * cross(w[i], n)
        if j >= 0:
            slip += v[j] - self._radius[j] * cross(w[j], n)
        return np.asarray(slip)

    def _contact(self, k: int, laws: ContactLaws, slow: float) -> Iterator[Broken]:
        """Judge one contact: a fault is a deviation for every order of the impacts and every normal."""
        J, pair = self.impulses[k], self._pairs[k]
        row = self._rows[k]
        i, j = self._ends[k]
        Kn = self._weight[i] + (self._weight[j] if j >= 0 else 0.0)
        size = float(np.sqrt(J @ J))
        least = self._noise + slow / Kn * IMPULSIVE
        if size <= 2.0 * least:
            return
        along = [float(J @ normals[k]) for normals in self._normals]
        threshold = IMPULSIVE * size + least
        if max(along) < -threshold:
            yield Broken(PULL, -max(along) / threshold, pair, "pull each other: a contact can only push")
            return
        if abs(min(along)) <= threshold:
            return
        touched = self._near.gap_before[row] <= 0.0  # the contact may return elastic energy
        ratios, works, whole = [], [], []
        swing = self._depth[k] * sum(self._rolled[b] for b in (i, j) if b >= 0) / self._dt
        for normals in self._normals:
            n = normals[k]
            Jt = J - (J @ n) * n
            for u0, u1 in self._states(k, normals):
                mean = 0.5 * (u0 + u1)
                whole.append(float(J @ mean))
                slip = lengths((u0 - (u0 @ n) * n)[None, :])[0] + lengths((u1 - (u1 @ n) * n)[None, :])[0]
                works.append((float(Jt @ mean), lengths(Jt[None, :])[0] * (laws.friction * slip + slow + swing)))
                ratios.append((float(-(u0 @ n)), float(u1 @ n)))
            if len(self._rows) == 1:  # a resistance to rolling also changes the slip
                u1 = self._slip(k, n, self._v1, self._w1)
                slip = float(np.sqrt(max(float(u1 @ u1) - float(u1 @ n) ** 2, 0.0)))
                works.append((float(Jt @ u1), lengths(Jt[None, :])[0] * (laws.friction * slip + slow + swing)))
        rubs = float(np.sqrt(max(size * size - max(a * a for a in along), 0.0)))
        seen = (RUBBED + self._turned[k]) * size + least
        # in a soft contact, friction may also resist the acceleration by other contacts
        fresh = self._near.gap_before[row] > -SHALLOW * self._near.small[row]
        sudden = len(self._rows) == 1 or (fresh and all(before > slow and after > -slow for before, after in ratios))
        if self._spins and sudden and rubs > seen and all(work > allowed for work, allowed in works):
            excess = min(work / allowed for work, allowed in works)
            yield Broken(FRICTION, excess, pair, "rub with the slip: the friction adds energy")
        known = laws.coefficient
        if self._spins and known is not None and rubs > known * max(along) + seen:
            excess = (rubs - known * max(along)) / seen
            what = f"rub with {rubs / max(along):.3g} of their normal impulse; the model says {known:.3g}"
            yield Broken(FRICTION, excess, pair, what)
        gains = [after - abs(before) - laws.restitution * max(before, 0.0) for before, after in ratios]
        # beside another contact, engines may use the normal of an earlier step, and friction then seems to remove most
        # of the energy
        kept = len(self._rows) == 1 or min(whole) > KEPT * min(along) * min(gains)
        # an engine with rigid contacts gives overlapping bodies no more speed than a correction
        allowed = slow + (PARTED * self._depth[k] / self._dt if touched else 0.0)
        if min(gains) > allowed and kept:
            closing = min(before for before, _ in ratios)
            how = "rebound faster than they closed" if closing > 0.0 else "are pushed apart while they part"
            broken = Broken(RESTITUTION, min(gains) / allowed, pair, how)
            if touched:
                laws.rebounds.suspected.append((*self._place_in_time, broken))
            else:
                yield broken

    def _impact(self, k: int, step: int, time: float, slow: float) -> IsolatedImpact | None:
        """Return the impact of a contact that rebounded; None if there is none."""
        row = self._rows[k]
        if not self._near.gap_before[row] > -SHALLOW * self._near.small[row]:
            return None
        found = []
        for normals in self._normals:
            n = normals[k]
            found += [(-float(u0 @ n), float(u1 @ n)) for u0, u1 in self._states(k, normals)]
        closing, parting = np.array(found).T
        if not closing.min() > slow or not parting.max() > 0.0:
            return None
        e = parting / closing
        return IsolatedImpact(step, time, self._pairs[k], float(closing.mean()), float(np.median(e)), float(np.ptp(e)))

    def _torques(self, laws: ContactLaws) -> Iterator[Broken]:
        """Judge the spins of an isolated contact: its impulse must explain them, except for a resistance to rolling.

        The torques of all contacts are kept for a comparison at the end of the run.
        """
        if not self._spins:
            return
        sizes = lengths(self.impulses)
        for body in np.flatnonzero(self._ease > 0.0).tolist():
            own = [k for k, ends in enumerate(self._ends) if body in ends]
            largest = float(sizes[own].sum())
            r, angular = self._radius[body], (self._w1[body] - self._w0[body]) / self._ease[body]
            arms = [-r * sum(cross(normals[k], self.impulses[k]) for k in own) for normals in self._normals]
            # arms that end at the surface, or inside the overlap
            parts = [1.0, 1.0 - 0.5 * float(self._depth[own].max()) / r]
            number = int(self._bodies[body])
            ways = np.array([part * arm for part in parts for arm in arms])
            turned = None if self._turned_spins is None else self._turned_spins[body] / self._ease[body]
            rests = [angular - arm for arm in arms]
            rolls = [
                any(float(rest @ spin) <= 0.0 for k in own for spin in self._spins_on(body, k, arm))
                for arm, rest in zip(arms, rests, strict=True)
            ]
            sample = ContactTorque(*self._place_in_time, number, angular, turned, ways, any(rolls))
            laws.torques.add(sample, r * largest, r * self._noise)
            if len(self._rows) > 1:
                continue
            loose = r * (IMPULSIVE + self._turned[0] + self._rolled[body]) + self._depth[0]
            excess = []
            for arm, rest, resists in zip(arms, rests, rolls, strict=True):
                allowed = SPUN * float(np.sqrt(arm @ arm)) + r * self._noise + loose * largest
                excess.append(0.0 if resists or not allowed > 0.0 else float(np.sqrt(rest @ rest)) / allowed)
            if min(excess) > 1.0:
                yield Broken(
                    SPIN, min(excess), (number,), "spins up by a torque that no force at its surface can exert"
                )

    def _spins_on(self, body: int, k: int, torque: FloatArray) -> Iterator[FloatArray]:
        """Yield spins (3,) relative to the other end of contact k: before its torque, after it, and after the step."""
        i, j = self._ends[k]
        other = j if body == i else i
        still = np.zeros(3)
        first, last = (still, still) if other < 0 else (self._w0[other], self._w1[other])
        yield self._w0[body] - first
        yield self._w0[body] + self._ease[body] * torque - first
        yield self._w1[body] - last
