"""The audit of another engine's run: violated laws and their times, judged from states alone.

Between two states, the bodies are divided into clusters that cannot have touched each other. In a cluster that touched
neither a plane nor anything fixed,

    Σ m Δv = Σ m g Δt        momentum
    Δ Σ (m (x - X) × (v - V) + I ω) = 0        angular momentum about the centre of mass X

hold for any contact model. The energy never rises, and falls only in contacts. A soft contact returns energy, so a rise
counts only once it exceeds the energy that the contact has absorbed. Bodies that attract each other are one cluster.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, fields

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.engines.engine_contacts import EngineMoment, Near, lengths
from carom.engines.source import Setup
from carom.errors import RecordingError
from carom.event import Event
from carom.physics.contact.impact_log import IMPACT
from carom.physics.contact.islands import number_sets
from carom.physics.contact.law import MATERIAL
from carom.physics.contact.loads import LOAD
from carom.physics.diagnostics.dissipation import WRONG, WRONG_WORK, JudgedEnds, judge_impacts
from carom.physics.diagnostics.energy import Energy
from carom.scene.units.dimension import ENERGY, VELOCITY
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import Names, bodies_called


@dataclass(frozen=True, slots=True)
class Clusters:
    """Sets of bodies that touched nothing outside their set between two moments."""

    label: IntArray  # (n,)
    count: int
    touched: BoolArray  # (count,) whether any of its bodies may have touched
    judged: BoolArray  # (count,) whether the laws of all its bodies are known
    free: BoolArray  # (count,) whether it also touched nothing fixed

    def sum(self, values: FloatArray) -> FloatArray:
        """Add up values of bodies, (n,) or (n, 3), by cluster."""
        if values.ndim == 1:
            return np.asarray(np.bincount(self.label, values, self.count), dtype=np.float64)
        return np.stack([np.bincount(self.label, column, self.count) for column in values.T], axis=1)


def clusters_of(setup: Setup, near: Near, *, whole: bool) -> Clusters:
    """Divide the bodies into clusters, or put all into one if ``whole``, as for bodies that attract each other."""
    n = len(setup)
    anchored = np.zeros(n, bool)
    i, j = near.pairs.T
    plane = j >= n
    anchored[i[plane]] = True
    i, j = i[~plane], j[~plane]
    loose = ~(setup.fixed[i] | setup.fixed[j])
    anchored[i[setup.fixed[j]]] = True
    anchored[j[setup.fixed[i]]] = True
    touched = np.zeros(n, bool)
    touched[near.pairs[near.pairs < n]] = True
    if whole:
        label, count = np.zeros(n, dtype=np.int64), 1
        anchored |= setup.fixed.any()
    else:
        label = np.empty(n, dtype=np.int64)
        count = number_sets(i[loose], j[loose], label)
    strange = np.bincount(label, ~setup.judged, count) > 0
    held = np.bincount(label, anchored | setup.fixed, count) > 0
    return Clusters(label, count, np.bincount(label, touched, count) > 0, ~strange, ~strange & ~held)


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Largest errors that do not violate a law."""

    energy: float = 1e-3  # of the energy of the cluster, between two frames
    drift: float = 1e-2  # of the energy scale, since the start
    momentum: float = 1e-3  # of Σ m |v| of the cluster
    angular_momentum: float = 1e-3  # of Σ (m |x| |v| + I |ω|) of the cluster
    overlap: float = 0.05  # of the smaller radius
    dissipation: float = 0.01  # of ½ μ v_n² of an impact

    def __post_init__(self) -> None:
        for each in fields(self):
            value = getattr(self, each.name)
            if not value >= 0.0:  # NaN would accept everything
                raise RecordingError(f"the tolerance {each.name} is {value}; it must be 0 or more")


@dataclass(frozen=True, slots=True)
class Fault:
    """A violated law.

    It is "energy", "momentum", "angular-momentum", "overlap", "missed-impact", "dissipation" or "not-finite".
    """

    law: str
    step: int
    time: float  # s
    amount: float  # error in units of the law's scale
    text: str  # a sentence
    bodies: tuple[int, ...] = ()  # numbers from n on are planes

    @property
    def event(self) -> Event:
        """The fault as a line of the log."""
        return Event(self.step, self.time, "WARN", self.text, f"law-{self.law}")


@dataclass(slots=True)
class AuditFinding:
    """Results of the audit of one frame."""

    faults: list[Fault] = field(default_factory=list)
    taken: float = 0.0  # J, absorbed by contacts; negative where contacts returned energy
    unjudged: float = 0.0  # J, lost by clusters with unjudged bodies
    struck: float = 0.0  # J, Σ ½ μ v_n² of the contacts whose velocity reversed
    impacts: int = 0  # number of these contacts
    hardest: float = 0.0  # J, ½ μ v_n² of the hardest of these contacts
    hardest_pair: tuple[int, int] = (0, 0)


UNCHANGED = 1e-3  # of the closing speed; a smaller change does not count as contact
TUNNELLED = 0.5  # of the closing speed; bodies that pass through each other and keep more of it have not collided
SHALLOW = 1e-3  # of the smaller radius; such bodies count as apart
FOUND = 5e-3  # of the smaller radius; at this depth even a soft contact must exert a force
STILL = 0.05  # of the typical speed; slower contacts are at rest, where forces may balance
AT_LEAST = 1e-2  # of a typical body's momentum or energy; smaller changes are noise
UNSEEN = 4 * float(np.finfo(np.float64).eps)  # of a position, which a motion must change from one frame to the next
MOST_NAMED = 8  # bodies in a sentence
TOLD = 3  # events reported for each law


class LawAudit:
    """Judges moments one after another."""

    def __init__(
        self,
        setup: Setup,
        tolerances: Tolerances,
        names: Names,  # of bodies and planes
        units: UnitSystem = SI,  # of the numbers, and of the numbers in messages of faults
        ends: IntArray | None = None,  # (n + p,) numbers of bodies and planes in names and faults; or their indices
    ) -> None:
        self._setup = setup
        self._ends = np.arange(len(setup) + len(setup.planes)) if ends is None else ends
        self._tolerances = tolerances
        self._names = names
        self._units = units
        self._owed = np.zeros(len(setup))  # J, absorbed from each body by contacts since it was last free
        self._typical = 0.0  # m/s
        self._unseen = 0.0  # m/s, too slow to change a position from the previous frame to this one
        self._allowed = 0.0  # J, accumulated error of first-order steps in the uniform field, and of unseen motion
        self.counts: dict[str, int] = {}  # number of frames that violated each law
        self.first: dict[str, Fault] = {}
        self.broken: list[tuple[float, str]] = []  # s and law, for each of these frames

    def see(
        self, step: int, before: EngineMoment, now: EngineMoment, near: Near, potentials: tuple[float, float] | None
    ) -> AuditFinding:
        """Judge a moment after that of the previous frame, given the pairs that may have touched in between.

        The potential energies (J) of the bodies' own gravity are those of both moments; None without gravity.
        """
        found = AuditFinding()
        relative = now.velocity - self._setup.mass @ now.velocity / self._setup.mass.sum()
        self._typical = max(self._typical, float(np.sqrt(np.mean(np.einsum("ij,ij->i", relative, relative)))))
        dt = now.time - before.time
        self._unseen = UNSEEN * float(np.abs(now.position).max()) / dt if dt > 0.0 else 0.0
        clusters = clusters_of(self._setup, near, whole=potentials is not None)
        place = step, now.time
        faults = [
            *self._momenta(place, before, now, clusters),
            *self._energy(place, before, now, clusters, potentials, found),
            *self._contacts(place, before, now, near, found),
        ]
        found.faults = [fault for fault in faults if self.note(fault)]
        return found

    def drifted(self, step: int, time: float, energy: Energy) -> Fault | None:
        """Judge the change of energy since the start, of the judged bodies, as far as no contact explains it."""
        error = energy.integration_error
        relative = energy.relative(error)
        if abs(error) <= self._allowed or abs(relative) <= self._tolerances.drift or "energy" in self.first:
            return None
        way = "risen" if error > 0.0 else "fallen"
        text = f"Energy has {way} by {abs(relative):.2%} of its scale since the start, and no contact explains it."
        fault = Fault("energy", step, time, abs(relative), text)
        return fault if self.note(fault) else None

    def closing(self) -> Iterator[tuple[str, str | int | float]]:
        """Yield the first fault of each law and the number of its frames, under the dotted keys of `outcome`.

        The number of judged bodies comes first, unless all were judged.
        """
        if not self._setup.judged.all():
            yield "audit.judged", int(np.count_nonzero(self._setup.judged))
        for law, first in self.first.items():
            found: dict[str, str | int | float]
            found = {"frames": self.counts[law], "step": first.step, "time": first.time, "text": first.text}
            yield from ((f"laws.{law}.{name}", value) for name, value in found.items())

    def go_on(self, earlier: LawAudit) -> None:
        """Continue the counts of an earlier audit, of other bodies."""
        self.counts, self.first, self.broken = earlier.counts, earlier.first, earlier.broken
        self._typical, self._allowed = earlier._typical, earlier._allowed

    def note(self, fault: Fault) -> bool:
        """Count a fault, also of another check; return whether it is among the first of its law."""
        self.first.setdefault(fault.law, fault)
        self.broken.append((fault.time, fault.law))
        self.counts[fault.law] = self.counts.get(fault.law, 0) + 1
        return self.counts[fault.law] <= TOLD

    def _momenta(
        self, place: tuple[int, float], before: EngineMoment, now: EngineMoment, clusters: Clusters
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
        tolerance, change = self._tolerances.angular_momentum, lengths(l1 - l0) - size * self._unseen
        yield from self._worst("angular-momentum", place, clusters, change, scale, tolerance)

    def _spin(self, moment: EngineMoment, clusters: Clusters, mass: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return each cluster's angular momentum about its centre of mass, and Σ (m |x| |v| + I |ω|)."""
        m = self._setup.mass
        x = moment.position - m @ moment.position / m.sum()
        x = x - (clusters.sum(m[:, None] * x) / mass[:, None])[clusters.label]
        v = moment.velocity - (clusters.sum(m[:, None] * moment.velocity) / mass[:, None])[clusters.label]
        each, size = m[:, None] * _cross(x, v), m * lengths(x) * lengths(v)
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
        yield Fault(law, *place, float(share[worst]), text, tuple(self._ends[members[:MOST_NAMED]].tolist()))

    def _energy(
        self,
        place: tuple[int, float],
        before: EngineMoment,
        now: EngineMoment,
        clusters: Clusters,
        potentials: tuple[float, float] | None,
        found: AuditFinding,
    ) -> Iterator[Fault]:
        """Compare the energy of every cluster with known laws; book the energy absorbed by contacts."""
        setup, g = self._setup, self._setup.gravity
        dt, strength = now.time - before.time, float(np.sqrt(g @ g))
        kinetic = [self._kinetic(moment) for moment in (before, now)]
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
        # the energy error of a first-order step in a uniform field, and of unseen motion
        rounding = mass * (strength * strength * dt * dt + self._unseen**2)
        self._allowed += float(rounding.sum())
        owed = clusters.sum(self._owed)
        back = np.where(clusters.touched, np.clip(change, 0.0, owed), 0.0)
        taken = np.where(clusters.touched, np.maximum(-change, 0.0), 0.0)
        found.taken = float((taken - back)[clusters.judged].sum())
        found.unjudged = -float(change[~clusters.judged].sum())
        self._book(clusters, taken, back, owed)
        wrong = np.where(clusters.touched, np.maximum(change, 0.0) - back, change)
        excess = np.where(clusters.judged, np.abs(wrong) - rounding, 0.0)
        share = np.where(scale > 0.0, excess / np.where(scale > 0.0, scale, 1.0), 0.0)
        worst = int(np.argmax(share))
        if share[worst] <= self._tolerances.energy:
            return
        members = np.flatnonzero(clusters.label == worst)
        came = "came from nothing" if wrong[worst] > 0.0 else "was lost while nothing touched"
        much = self._units.text(abs(float(wrong[worst])), ENERGY, ".3g")
        text = f"Energy {came}: {much}, {share[worst]:.2%} of that of {self._called(members)}."
        yield Fault("energy", *place, float(share[worst]), text, tuple(self._ends[members[:MOST_NAMED]].tolist()))

    def _book(self, clusters: Clusters, taken: FloatArray, back: FloatArray, owed: FloatArray) -> None:
        """Divide the energy absorbed by contacts among each cluster's bodies; without contacts, nothing is owed."""
        label = clusters.label
        members = np.bincount(label, minlength=clusters.count)
        left = np.where(owed > 0.0, 1.0 - back / np.where(owed > 0.0, owed, 1.0), 0.0)
        self._owed = np.where(clusters.touched[label], self._owed * left[label] + (taken / members)[label], 0.0)

    def _kinetic(self, moment: EngineMoment) -> FloatArray:
        """Return the kinetic energy of every body, (n,) J."""
        energy = 0.5 * self._setup.mass * np.einsum("ij,ij->i", moment.velocity, moment.velocity)
        if len(moment.spin):
            energy = energy + 0.5 * self._setup.inertia * np.einsum("ij,ij->i", moment.spin, moment.spin)
        return np.asarray(energy, dtype=np.float64)

    def _contacts(
        self, place: tuple[int, float], before: EngineMoment, now: EngineMoment, near: Near, found: AuditFinding
    ) -> Iterator[Fault]:
        """Find overlaps, impacts, impacts that were missed, and those that dissipate what they may not."""
        if len(near) == 0:
            return
        dt = now.time - before.time
        n, setup = len(self._setup), self._setup
        judged = np.append(setup.judged, np.ones(len(setup.planes), bool))
        known = judged[near.pairs].all(axis=1)
        depth = np.where(known, -near.gap_now / near.small, 0.0)
        deepest = int(np.argmax(depth))
        if depth[deepest] > self._tolerances.overlap:
            text = f"{self._pair(near, deepest)} overlap by {depth[deepest]:.1%} of the smaller radius."
            yield Fault("overlap", *place, float(depth[deepest]), text, tuple(self._ends[near.pairs[deepest]].tolist()))
        still = STILL * self._typical + 2.0 * float(np.sqrt(setup.gravity @ setup.gravity)) * dt
        at = near.directions_of_touch()
        plane = near.pairs[:, 1] >= n
        normal = np.where(plane[:, None], near.normal, at)
        # a plane does not fall, so the speed that the field adds towards the plane is not due to an impulse
        push = np.where(plane, normal @ setup.gravity * dt, 0.0)
        closing = -np.einsum("ij,ij->i", near.relative_before, normal)
        after = -np.einsum("ij,ij->i", near.relative_now, normal) - push
        overlapped = near.gap_before < -SHALLOW * near.small
        ignored = (near.gap_before < -FOUND * near.small) & (closing > still) & (after > (1.0 - UNCHANGED) * closing)
        inside = np.einsum("ij,ij->i", near.now, normal) < 0.0
        passed = np.where(plane, inside, (near.gap_now >= -SHALLOW * near.small) | inside)
        through = near.passed_deep() & ~overlapped & passed & (closing > still) & (after > TUNNELLED * closing)
        missed = np.flatnonzero(known & (ignored | through))
        if len(missed):
            worst = int(missed[np.argmax(closing[missed])])
            how = "passed through each other" if through[worst] else "touch, and this step did not separate them"
            speed = self._units.text(float(closing[worst]), VELOCITY, ".3g")
            text = f"Missed impact: {self._pair(near, worst)} {how}, closing at {speed}."
            ends = tuple(self._ends[near.pairs[worst]].tolist())
            yield Fault("missed-impact", *place, float(closing[worst]), text, ends)
        met = (near.gap_before > 0.0) & ((near.gap_now <= 0.0) | (after < TUNNELLED * closing))
        met &= near.gap_before <= closing * dt  # otherwise another body reversed them
        struck = met & known & (closing > still)
        self._impacts(near, np.where(struck, closing, 0.0), found)
        # an impact that began and ended in this frame, of bodies that touched nothing else
        counts = np.bincount(near.pairs.ravel(), minlength=n + len(setup.planes))
        counts[n:] = 1
        whole = np.flatnonzero(struck & (after < 0.0) & (counts[near.pairs] == 1).all(axis=1))
        if len(whole) and setup.spins:
            yield from self._dissipation(place, before, now, near, whole, at[whole], closing[whole])

    def _dissipation(
        self,
        place: tuple[int, float],
        before: EngineMoment,
        now: EngineMoment,
        near: Near,
        whole: IntArray,
        normal: FloatArray,
        closing: FloatArray,
    ) -> Iterator[Fault]:
        """Judge the losses of whole impacts, rows of ``near``, as carom judges those of its own runs.

        The impulse and the work of its parts, -J (v + v') / 2, follow from the velocities of both frames. The tolerance
        is larger because the field may act before or after an impact at something fixed, and the normal turns.
        """
        setup, n, dt = self._setup, len(self._setup), now.time - before.time
        i, j = near.pairs[whole].T
        free = (j < n) & ~setup.fixed[np.minimum(j, n - 1)]
        pushed = np.where(free, j, i)
        change = now.velocity[pushed] - before.velocity[pushed] - setup.gravity * dt
        impulse = np.where(free, 1.0, -1.0)[:, None] * setup.mass[pushed][:, None] * change
        lost = []
        for moment, relative in ((before, near.relative_before), (now, near.relative_now)):
            surface = setup.radius[i][:, None] * moment.spin[i]
            surface[j < n] += setup.radius[j[j < n]][:, None] * moment.spin[j[j < n]]
            velocity = relative[whole] - _cross(surface, normal)
            along = np.einsum("ij,ij->i", impulse, normal) * np.einsum("ij,ij->i", velocity, normal)
            lost.append((-0.5 * along, along - np.einsum("ij,ij->i", impulse, velocity)))
        log = np.zeros(len(whole), IMPACT)
        log["i"], log["j"], log["approach"], log["clock"] = i, j, closing, np.arange(len(whole))
        log["restitution_loss"] = lost[0][0] + lost[1][0]
        log["friction_loss"] = 0.5 * (lost[0][1] + lost[1][1])
        anchored = ~free | setup.fixed[i]
        fallen = np.where(anchored, lengths(setup.gravity[None, :])[0] * dt, 0.0)
        directions = [apart / lengths(apart)[:, None] for apart in (near.before[whole], near.now[whole])]
        turned = lengths(directions[1] - directions[0]) * lengths(near.relative_before[whole])
        slips = lengths(impulse) * (fallen + turned)  # J, by velocities that are uncertain by so much
        weight = np.where(setup.fixed[i], 0.0, 1.0 / setup.mass[i]) + np.where(free, 1.0 / setup.mass[pushed], 0.0)
        tolerance = self._tolerances.dissipation + 2.0 * slips * weight / closing**2
        materials = np.zeros(1 + len(setup.planes), MATERIAL)
        materials["restitution"] = np.nan if setup.restitution is None else setup.restitution
        inverse_mass = np.append(np.where(setup.fixed, 0.0, 1.0 / setup.mass), np.zeros(len(setup.planes)))
        ends = JudgedEnds(materials, np.empty((0, 2), np.int64), inverse_mass, n, False, False)
        unloaded = dt, np.zeros((len(inverse_mass), 3)), np.zeros(len(inverse_mass), LOAD)
        wrong = np.zeros(len(WRONG), WRONG_WORK)
        judge_impacts(log, ends, unloaded, tolerance, *place, wrong)
        for sentence, row in zip(WRONG, wrong, strict=True):
            if row["energy"] > 0.0:
                pair = np.array([row["i"], row["j"]])
                energy = self._units.text(float(row["worst"]), ENERGY, ".3g")
                text = f"{sentence}: {energy} by {self._names.pair(self._ends[pair].tolist())}."
                yield Fault("dissipation", *place, float(row["energy"]), text, tuple(self._ends[pair].tolist()))

    def _impacts(self, near: Near, closing: FloatArray, found: AuditFinding) -> None:
        """Book the impacts, given their closing speeds in m/s; 0 for other pairs."""
        inverse = np.append(np.where(self._setup.fixed, 0.0, 1.0 / self._setup.mass), np.zeros(len(self._setup.planes)))
        weight = inverse[near.pairs].sum(axis=1)
        struck = np.where(weight > 0.0, 0.5 * closing**2 / np.where(weight > 0.0, weight, 1.0), 0.0)
        found.struck, found.impacts = float(struck.sum()), int(np.count_nonzero(struck))
        hardest = int(np.argmax(struck))
        found.hardest = float(struck[hardest])
        found.hardest_pair = int(near.pairs[hardest, 0]), int(near.pairs[hardest, 1])

    def _pair(self, near: Near, row: int) -> str:
        text = self._names.pair(self._ends[near.pairs[row]].tolist())
        return text[0].upper() + text[1:]

    def _called(self, bodies: IntArray) -> str:
        if len(bodies) == len(self._setup) > 2:
            return "all bodies together"
        return bodies_called(self._ends[bodies].tolist(), self._names.bodies)


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return a × b for rows of three; `numpy.cross` takes eight times as long for a few."""
    (x, y, z), (u, v, w) = a.T, b.T
    return np.stack((y * w - z * v, z * u - x * w, x * v - y * u), axis=1)
