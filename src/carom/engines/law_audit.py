"""The audit of another engine's run: violated laws and their times, judged from states alone.

Between two states, the bodies are divided into clusters that cannot have touched each other. In a cluster that touched
neither a plane nor anything fixed, the equations

    Σ m Δv = Σ m g Δt        momentum
    Δ Σ (m (x - X) × (v - V) + I ω) = 0        angular momentum about the centre of mass X

hold for any contact model. The energy never rises, and falls only in contacts. A soft contact returns energy, so a rise
is a fault only once it exceeds the energy that the contact has absorbed. Bodies that attract each other are one
cluster.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

import numpy as np

from carom.arrays import FloatArray, IntArray, Records
from carom.engines.clusters import Clusters, clusters_of
from carom.engines.elastic_energy import TINY, ElasticEnergy, reduced_masses
from carom.engines.engine_contacts import EngineMoment, Near, cross, lengths, rotation_between
from carom.engines.faults import Broken, Fault, Tolerances
from carom.engines.known_forces import KnownForces
from carom.engines.missed_impacts import TUNNELLED, MissedImpacts, Unresolved
from carom.engines.reported_contacts import judge_reported
from carom.engines.single_contacts import ContactLaws
from carom.engines.source import Setup
from carom.engines.strikes import Strikes
from carom.recording.schema.header import LARGEST
from carom.scene.units.dimension import ENERGY, VELOCITY
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import Names, bodies_called
from carom.state.energies import Energy


@dataclass(slots=True)
class AuditFinding:
    """Results of the audit of one frame."""

    faults: list[Fault] = field(default_factory=list)
    taken: float = 0.0  # J, energy absorbed by contacts; negative if contacts returned energy
    forced: float = 0.0  # J, work of damping and of the external forces given to the engine
    unjudged: float = 0.0  # J, energy lost by clusters with unjudged bodies
    struck: float = 0.0  # J, Σ ½ μ v_n² over contacts whose velocity reversed
    impacts: int = 0  # number of contacts whose velocity reversed
    hardest: float = 0.0  # J, largest ½ μ v_n² of a contact whose velocity reversed
    hardest_pair: tuple[int, int] = (0, 0)
    deepest: float = 0.0  # deepest overlap relative to the smaller radius, whether or not the engine reports a contact
    deepest_pair: tuple[int, int] = (0, 0)


STILL = 0.05  # fraction of the typical speed below which touching bodies may rest in a balance of forces
AT_LEAST = 1e-2  # smallest change, relative to a typical body's momentum or energy, that is not noise
OFF_AXIS = 0.3  # largest distance of a contact's impulse from the normal, relative to the arm
UNSEEN = 4 * float(np.finfo(np.float64).eps)  # smallest relative change of a position that shows motion between frames
TURNED = 0.05  # relative error of a rotation in a frame, since engines integrate rotations to first order
ROUNDED = 1e-5  # rad, rounding of orientations in single precision
MOST_TURN = 0.5  # rad; engines limit or approximate larger rotations in one step
MOST_NAMED = 8  # largest number of bodies that a sentence names
TOLD = 3  # largest number of events that are reported for each law


class LawAudit:
    """Judges moments one after another."""

    def __init__(
        self,
        setup: Setup,
        tolerances: Tolerances,
        names: Names,  # names of bodies and planes
        units: UnitSystem = SI,  # units of the numbers, also in messages of faults
        ends: IntArray | None = None,  # (n + p,) numbers of bodies and planes in names and faults; by default indices
    ) -> None:
        self._setup = setup
        self._ends = np.arange(len(setup) + len(setup.planes)) if ends is None else ends
        self._tolerances = tolerances
        self._names = names
        self._units = units
        self._laws = ContactLaws(setup, tolerances.restitution, tolerances.friction)
        self._elastic = ElasticEnergy(setup)
        self._forces = KnownForces(setup)
        self._typical = 0.0  # m/s, typical speed of the bodies
        self._missed = MissedImpacts(setup)
        self._strikes = Strikes()
        self._parted = 0.0  # largest fraction of a cluster's energy gained in a frame by pushing overlaps apart
        self._unseen = 0.0  # m/s, largest speed too slow to change a position between two frames
        self._allowed = 0.0  # J, allowance for first-order steps in the field, unseen motion, and overlaps pushed apart
        self.counts: dict[str, int] = {}  # number of frames that violated each law
        self.first: dict[str, Fault] = {}
        self.worst: dict[str, float] = {}  # largest ratio of violation to tolerance for each law
        self.broken: list[tuple[float, str]] = []  # time (s) and violated law of each frame that violated a law

    def see(
        self,
        step: int,
        before: EngineMoment,
        now: EngineMoment,
        near: Near,
        potentials: tuple[float, float] | None,
        reported: Records | None = None,
    ) -> AuditFinding:
        """Judge a moment, given the pairs that may have touched since the previous frame.

        The engine's own contacts of the last step, (m,) `CONTACT`, are also judged if they have forces.

        ``potentials`` are the energies (J) of the bodies' mutual gravity at both moments; None without gravity.
        """
        found = AuditFinding()
        anchored = len(self._setup.planes) > 0 or bool(self._setup.fixed.any())
        bulk = 0.0 if anchored else self._setup.mass @ now.velocity / self._setup.mass.sum()
        relative = now.velocity - bulk
        self._typical = max(self._typical, float(np.sqrt(np.mean(np.einsum("ij,ij->i", relative, relative)))))
        dt = now.time - before.time
        done = self._forces.work
        before = self._forces.applied(before, now, near)
        found.forced = self._forces.work - done
        self._unseen = UNSEEN * float(np.abs(now.position).max()) / dt if dt > 0.0 else 0.0
        clusters = clusters_of(self._setup, near, whole=potentials is not None)
        place = step, now.time
        faults = [
            *self._momenta(place, before, now, near, clusters),
            *self._energy(place, before, now, near, clusters, potentials, found),
            *self._contacts(place, before, now, near, found),
            *self._reported(place, before, now, reported),
            *self._rotations(place, before, now, near),
        ]
        found.faults = [fault for fault in faults if self.note(fault)]
        return found

    def drifted(self, step: int, time: float, energy: Energy) -> Fault | None:
        """Judge the energy that the judged bodies gained or lost outside of contacts since the start."""
        error = energy.integration_error
        relative = energy.relative(float(np.sign(error)) * max(abs(error) - self._allowed, 0.0))
        if abs(relative) <= self._tolerances.drift or "energy" in self.first:
            return None
        way = "risen" if error > 0.0 else "fallen"
        text = f"Energy has {way} by {abs(relative):.2%} of its scale since the start, and no contact explains it."
        fault = Fault("energy", step, time, abs(relative), text, (), abs(relative) / max(self._tolerances.drift, TINY))
        return fault if self.note(fault) else None

    def closing(self) -> Iterator[tuple[str, str | int | float]]:
        """Yield the first fault of each law and the number of frames that break it, under the dotted keys of `outcome`.

        The faults are preceded by the number of judged bodies, unless all were judged, and by the energy added by
        pushing overlaps apart.
        """
        self.conclude()
        if not self._setup.judged.all():
            yield "audit.judged", int(np.count_nonzero(self._setup.judged))
        if self._forces.work:
            yield "audit.forced", self._forces.work
        for name, damping in zip(("damping", "angular_damping"), self._forces.measured, strict=True):
            if any(damping.told):
                yield from zip((f"audit.{name}.rate", f"audit.{name}.by_speed"), damping.told, strict=True)
        if self._parted > self._tolerances.energy:
            yield "audit.parted", self._parted
        for law, first in self.first.items():
            found: dict[str, str | int | float]
            found = {"frames": self.counts[law], "step": first.step, "time": first.time, "text": first.text}
            found["excess"] = min(self.worst[law], LARGEST)
            found["bodies"] = ",".join(map(str, first.bodies))
            yield from ((f"laws.{law}.{name}", value) for name, value in found.items())

    def go_on(self, earlier: LawAudit) -> None:
        """Continue the counts of an earlier audit of other bodies."""
        self.counts, self.first, self.broken = earlier.counts, earlier.first, earlier.broken
        self.worst = earlier.worst
        self._typical, self._allowed = earlier._typical, earlier._allowed
        self._laws.go_on(earlier._laws)
        self._missed.go_on(earlier._missed)
        self._strikes = earlier._strikes
        self._forces.go_on(earlier._forces)
        self._parted = earlier._parted

    def note(self, fault: Fault) -> bool:
        """Count a fault, which may come from another check; return whether it is among the first faults of its law."""
        if fault.law not in self.first or fault.step < self.first[fault.law].step:
            self.first[fault.law] = fault
        self.worst[fault.law] = max(self.worst.get(fault.law, 0.0), fault.excess)
        self.broken.append((fault.time, fault.law))
        self.counts[fault.law] = self.counts.get(fault.law, 0) + 1
        return self.counts[fault.law] <= TOLD

    def _momenta(
        self, place: tuple[int, float], before: EngineMoment, now: EngineMoment, near: Near, clusters: Clusters
    ) -> Iterator[Fault]:
        """Compare the momenta of every free cluster."""
        m, dt = self._setup.mass, now.time - before.time
        mass = clusters.sum(m)
        bulk = m @ before.velocity / m.sum()
        v0, v1 = before.velocity - bulk, now.velocity - bulk
        p0, p1 = clusters.sum(m[:, None] * v0), clusters.sum(m[:, None] * v1)
        speed = np.maximum(lengths(v0), lengths(v1))
        change = lengths(p1 - p0 - mass[:, None] * self._setup.gravity * dt) - mass * self._unseen
        scale = clusters.sum(m * speed) + AT_LEAST * mass * self._typical
        yield from self._worst("momentum", place, clusters, change, scale, self._tolerances.momentum)
        if self._setup.box[0] > 0.0:
            return
        (l0, s0), (l1, s1) = (self._spin(moment, clusters, mass) for moment in (before, now))
        size = clusters.sum(m * self._setup.radius)
        scale = np.maximum(s0, s1) + AT_LEAST * size * self._typical
        # a contact may act anywhere in the overlap of two bodies
        kicks, n = m[:, None] * (v1 - v0 - self._setup.gravity * dt), len(m)
        deep, bodies = np.zeros(n), near.pairs[:, 1] < n
        for end in near.pairs[bodies].T:
            np.maximum.at(deep, end, -np.minimum(near.gap_before, near.gap_now)[bodies])
        change = l1 - l0
        # engines that make several steps in a frame keep contact points fixed while bodies move and turn
        ways = [cross(now.position - before.position - bulk * dt, kicks)]
        if len(now.spin):
            arms = self._setup.radius * dt
            turn = arms[:, None] * 0.5 * (before.spin + now.spin)
            size_of_kick = lengths(kicks)
            along = kicks / np.where(size_of_kick > 0.0, size_of_kick, 1.0)[:, None]
            ways.append(size_of_kick[:, None] * (turn - np.einsum("ij,ij->i", turn, along)[:, None] * along))
            deep += OFF_AXIS * arms * np.maximum(lengths(before.spin), lengths(now.spin))
        for way in ways:
            moved = clusters.sum(way)
            square = np.einsum("ij,ij->i", moved, moved)
            part = np.einsum("ij,ij->i", change, moved) / np.where(square > 0.0, square, 1.0)
            change = change - np.clip(part, 0.0, 1.0)[:, None] * moved
        # several contacts may act at different moments
        many = np.bincount(clusters.label, minlength=clusters.count) > 2
        off = lengths(np.where(many[:, None], l1 - l0, change))
        off -= np.where(many, sum(clusters.sum(lengths(way)) for way in ways), 0.0)
        off -= size * self._unseen + clusters.sum(deep * lengths(kicks))
        # an engine that pushes bodies apart moves them without changing their speeds
        parted = lengths(now.position - before.position - 0.5 * dt * (before.velocity + now.velocity))
        reach = np.zeros(n)
        for end in near.pairs[bodies].T:
            np.maximum.at(reach, end, -near.gap_before[bodies])
        off -= clusters.sum(m * speed * np.minimum(parted, reach))
        tolerance = self._tolerances.angular_momentum
        yield from self._worst("angular-momentum", place, clusters, off, scale, tolerance)

    def _spin(self, moment: EngineMoment, clusters: Clusters, mass: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return each cluster's angular momentum about its centre of mass, and Σ (m |x| |v| + I |ω|)."""
        m = self._setup.mass
        x = moment.position - m @ moment.position / m.sum()
        x = x - (clusters.sum(m[:, None] * x) / mass[:, None])[clusters.label]
        v = moment.velocity - (clusters.sum(m[:, None] * moment.velocity) / mass[:, None])[clusters.label]
        each, size = m[:, None] * cross(x, v), m * lengths(x) * lengths(v)
        if len(moment.spin):
            each = each + self._setup.inertia[:, None] * moment.spin
            size = size + self._setup.inertia * lengths(moment.spin)
        return clusters.sum(each), clusters.sum(size)

    def _worst(
        self,
        law: str,
        place: tuple[int, float],
        clusters: Clusters,
        change: FloatArray,
        scale: FloatArray,
        most: float,
    ) -> Iterator[Fault]:
        """Report the free cluster whose momentum changed most, if the change exceeds the tolerance."""
        share = np.where(clusters.free & (scale > 0.0), change / np.where(scale > 0.0, scale, 1.0), 0.0)
        worst = int(np.argmax(share))
        if share[worst] <= most:
            return
        members = np.flatnonzero(clusters.label == worst)
        called, what = self._called(members), law.replace("-", " ").capitalize()
        meanwhile = "while nothing touched"
        if len(members) > 1:
            touched = clusters.touched[worst]
            meanwhile = "in a contact among themselves" if touched else "while they attracted each other"
        text = f"{what} of {called} changed by {share[worst]:.2%} {meanwhile}."
        ends = tuple(self._ends[members[:MOST_NAMED]].tolist())
        yield Fault(law, *place, float(share[worst]), text, ends, float(share[worst]) / max(most, TINY))

    def _energy(
        self,
        place: tuple[int, float],
        before: EngineMoment,
        now: EngineMoment,
        near: Near,
        clusters: Clusters,
        potentials: tuple[float, float] | None,
        found: AuditFinding,
    ) -> Iterator[Fault]:
        """Compare the energy of every cluster with known laws; record the energy absorbed by contacts."""
        setup, g = self._setup, self._setup.gravity
        dt, strength = now.time - before.time, setup.field_strength
        kinetic = [moment.kinetic(setup) for moment in (before, now)]
        lifted = -setup.mass * ((now.position - before.position) @ g)
        lifted[setup.fixed] = 0.0
        change = clusters.sum(kinetic[1] - kinetic[0] + lifted)
        own = clusters.sum(np.maximum(*kinetic) + np.abs(lifted))
        if potentials is not None:
            change = change + (potentials[1] - potentials[0])
            own = own + abs(potentials[1])
        mass = clusters.sum(setup.mass)
        floor = AT_LEAST * mass * (self._typical**2 + strength * clusters.sum(setup.mass * setup.radius) / mass)
        scale = own + floor
        # the energy errors of a first-order step in a uniform field, and of unseen motion
        rounding = mass * (strength * strength * dt * dt + self._unseen**2)
        self._allowed += float(rounding.sum())
        owed = clusters.sum(self._elastic.owed)
        credit = self._elastic.credit(near, clusters)
        back = np.where(clusters.touched, np.clip(change, 0.0, credit * owed), 0.0)
        taken = np.where(clusters.touched, np.maximum(-change, 0.0), 0.0)
        found.taken = float((taken - back)[clusters.judged].sum())
        found.unjudged = -float(change[~clusters.judged].sum())
        self._elastic.book(clusters, near, owed + taken - back / credit)
        wrong = np.where(clusters.touched, np.maximum(change, 0.0) - back, change)
        parted = np.minimum(np.maximum(wrong, 0.0), self._elastic.by_parting(before, now, near, clusters))
        self._allowed += float(parted[clusters.judged].sum())
        parts = np.where(clusters.judged & (scale > 0.0), parted / np.where(scale > 0.0, scale, 1.0), 0.0)
        self._parted = max(self._parted, float(parts.max()))
        excess = np.where(clusters.judged, np.abs(wrong) - parted - rounding, 0.0)
        share = np.where(scale > 0.0, excess / np.where(scale > 0.0, scale, 1.0), 0.0)
        worst = int(np.argmax(share))
        if share[worst] <= self._tolerances.energy:
            return
        members = np.flatnonzero(clusters.label == worst)
        came = "came from nothing" if wrong[worst] > 0.0 else "was lost while nothing touched"
        much = self._units.text(abs(float(wrong[worst])), ENERGY, ".3g")
        text = f"Energy {came}: {much}, {share[worst]:.2%} of the energy of {self._called(members)}."
        ends, amount = tuple(self._ends[members[:MOST_NAMED]].tolist()), float(share[worst])
        yield Fault("energy", *place, amount, text, ends, amount / max(self._tolerances.energy, TINY))

    def _rotations(
        self, place: tuple[int, float], before: EngineMoment, now: EngineMoment, near: Near
    ) -> Iterator[Fault]:
        """Compare the rotation of each body that touched nothing with its spins at both ends of the frame."""
        dt = now.time - before.time
        if not (len(now.spin) and len(now.orientation)) or not dt > 0.0:
            return
        turn = rotation_between(before.orientation, now.orientation)
        off = np.minimum(*(lengths(turn - moment.spin * dt) for moment in (before, now)))
        free = self._setup.judged & ~self._setup.fixed & (lengths(turn) < MOST_TURN)
        free[near.pairs[near.pairs < len(free)]] = False
        excess = np.where(free, off / (TURNED * lengths(turn) + ROUNDED), 0.0)
        worst = int(np.argmax(excess))
        if excess[worst] > 1.0:
            end = int(self._ends[worst])
            text = f"{self._names.of(end)} turns differently from its spin: by {lengths(turn)[worst]:.3g} rad, off by "
            text = f"{text[0].upper()}{text[1:]}{off[worst]:.3g} rad. Spins are expected in the frame of the world."
            yield Fault("spin", *place, float(excess[worst]), text, (end,), float(excess[worst]))

    def _contacts(
        self, place: tuple[int, float], before: EngineMoment, now: EngineMoment, near: Near, found: AuditFinding
    ) -> Iterator[Fault]:
        """Find overlaps, impacts, missed impacts, and impacts that dissipate too much or too little."""
        if len(near) == 0:
            return
        dt = now.time - before.time
        n, setup = len(self._setup), self._setup
        judged = np.append(setup.judged, np.ones(len(setup.planes), bool))
        known = np.asarray(judged[near.pairs].all(axis=1))
        depth = np.where(known, -near.gap_now / near.small, 0.0)
        deepest = int(np.argmax(depth))
        if depth[deepest] > self._tolerances.overlap:
            pair = int(near.pairs[deepest, 0]), int(near.pairs[deepest, 1])
            text = f"{self._pair(pair)} overlap by {depth[deepest]:.1%} of the smaller radius."
            ends, overlap = tuple(self._ends[near.pairs[deepest]].tolist()), max(self._tolerances.overlap, TINY)
            yield Fault("overlap", *place, float(depth[deepest]), text, ends, float(depth[deepest]) / overlap)
        for inside in self._missed.contained(place, near, depth):
            text = f"{self._pair(inside.ends)} overlap by {inside.depth:.1%} of the smaller radius, "
            text = f"{text}and {inside.frames} frames did not part them."
            ends = tuple(self._ends[list(inside.ends)].tolist())
            yield Fault("overlap", inside.step, inside.time, inside.depth, text, ends, inside.depth)
        still, normal = still_speed(setup, self._typical, dt), near.normals_of_touch(n)
        # a plane does not fall, so the speed that the field adds towards a plane is not due to an impulse
        push = np.where(near.pairs[:, 1] >= n, normal @ setup.gravity * dt, 0.0)
        closing = -np.einsum("ij,ij->i", near.relative_before, normal)
        after = -np.einsum("ij,ij->i", near.relative_now, normal) - push
        speeds = closing, after
        yield from map(self._missed_impact, self._missed.see((*place, dt), near, known, speeds, still))
        met = (near.gap_before > 0.0) & ((near.gap_now <= 0.0) | (after < TUNNELLED * closing))
        met &= near.gap_before <= closing * dt  # otherwise another body reversed the pair's velocity
        met &= known & (closing > still)
        self._impacts(near, self._strikes.see(near, self._ends, met, (closing, after), normal), found)
        yield from self._worst_of_each(place, self._laws.see(place[0], before, now, near, closing, still))

    def _reported(
        self, place: tuple[int, float], before: EngineMoment, now: EngineMoment, reported: Records | None
    ) -> Iterator[Fault]:
        """Report the worst of the engine's own contacts for each law."""
        if reported is not None:
            slow = still_speed(self._setup, self._typical, now.time - before.time)
            judged = judge_reported(self._setup, reported, before, now, self._tolerances.friction, slow)
            yield from self._worst_of_each(place, judged)

    def _worst_of_each(self, place: tuple[int, float], found: Iterable[Broken]) -> Iterator[Fault]:
        worst: dict[str, Broken] = {}
        for broken in found:
            if broken.law not in worst or broken.excess > worst[broken.law].excess:
                worst[broken.law] = broken
        yield from (self._fault(place, broken) for broken in worst.values())

    def _fault(self, place: tuple[int, float], broken: Broken) -> Fault:
        ends = tuple(self._ends[list(broken.ends)].tolist())
        called = self._names.pair((ends[0], ends[1])) if len(ends) == 2 else self._names.of(ends[0])
        text = f"{called[0].upper()}{called[1:]} {broken.what}."
        return Fault(broken.law, *place, broken.excess, text, ends, broken.excess)

    def _missed_impact(self, impact: Unresolved) -> Fault:
        how = f"touch, and {impact.steps} steps did not separate them"
        how = "touch, and this step did not separate them" if impact.steps == 1 else how
        how = "passed through each other" if impact.passed else how
        speed = self._units.text(impact.speed, VELOCITY, ".3g")
        text = f"Missed impact: {self._pair(impact.ends)} {how}, closing at {speed}."
        ends = tuple(self._ends[list(impact.ends)].tolist())
        return Fault("missed-impact", impact.step, impact.time, impact.speed, text, ends, impact.excess)

    def conclude(self) -> None:
        """At the end of the run, judge impacts that differ from all others."""
        for late in self._missed.unusual():
            self.note(self._missed_impact(late))
        for step, time, broken in sorted(self._laws.concluded(), key=lambda found: found[0]):
            self.note(self._fault((step, time), broken))

    def _impacts(self, near: Near, closing: FloatArray, found: AuditFinding) -> None:
        """Record the impacts, given the closing speeds of all pairs in m/s, which are 0 for pairs without an impact."""
        struck = 0.5 * closing**2 * reduced_masses(self._setup, near)
        found.struck, found.impacts = float(struck.sum()), int(np.count_nonzero(struck))
        hardest = int(np.argmax(struck))
        found.hardest = float(struck[hardest])
        found.hardest_pair = int(near.pairs[hardest, 0]), int(near.pairs[hardest, 1])

    def _pair(self, ends: tuple[int, int]) -> str:
        text = self._names.pair(self._ends[list(ends)].tolist())
        return text[0].upper() + text[1:]

    def _called(self, bodies: IntArray) -> str:
        if len(bodies) == len(self._setup) > 2:
            return "all bodies together"
        return bodies_called(self._ends[bodies].tolist(), self._names.bodies)


def still_speed(setup: Setup, typical: float, dt: float) -> float:
    """Return the largest speed (m/s) of contacts at rest in a frame of dt s, given a typical speed in m/s."""
    return STILL * typical + 2.0 * setup.field_strength * dt
