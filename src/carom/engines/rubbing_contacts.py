"""The friction of isolated contacts, compared over a whole run with the friction of sliding contacts.

If a body touches nothing but one plane or one other body, its momentum gives the impulse of this contact. While a
contact slides, Coulomb's law fixes the ratio of friction to normal impulse, μ; while it sticks, μ limits the ratio. At
the end of a run, μ is known as the ratio that most sliding contacts of this engine have. A contact of the same bodies
with another ratio breaks the law.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from carom.arrays import BoolArray, FloatArray, IntArray
from carom.engines.engine_contacts import EngineMoment, Near, cross, lengths
from carom.engines.faults import FRICTION, MOSTLY, SPREADS, Broken, BrokenThen
from carom.engines.source import Setup

FEWEST = 20  # smallest number of sliding contacts that show μ
# slip that counts as sliding, relative to the largest speed at rest; soft friction lets a sticking contact creep
SLIDING = 0.1
CLEAR = 20.0  # smallest clear impulse, in multiples of its noise
ROUNDED = 1e-6  # rounding relative to m |v| in engines that compute in single precision
EXACT = 0.02  # single contacts are judged if most contacts deviate by at most this, relative to μ
OFF = 0.1  # smallest deviation of a fault, relative to μ
RARELY = 0.05  # fraction of the sticking contacts; if more of these exceed μ, the engine's static friction is larger
MOST_FRAMES = 100_000  # largest number of frames with samples


@dataclass(frozen=True, slots=True)
class RubbedFrame:
    """Isolated contacts of one frame, (m,), and for each the range of the ratio of friction to normal impulse."""

    step: int
    time: float  # s
    ends: IntArray  # (m, 2)
    least: FloatArray
    most: FloatArray
    slides: BoolArray
    strikes: BoolArray  # whether the bodies closed fast


@dataclass(slots=True)
class RubbingContacts:
    """The friction of isolated contacts over a run."""

    frames: list[RubbedFrame] = field(default_factory=list)

    def see(
        self,
        place: tuple[int, float],  # step and time in s
        setup: Setup,
        moments: tuple[EngineMoment, EngineMoment],
        near: Near,
        rows: IntArray,  # rows of near pairs that touched nothing else in the frame
        closing: FloatArray,  # (k,) m/s, closing speeds of all near pairs before the frame
        slow: float,  # m/s, speed up to which contacts may rest
    ) -> None:
        """Keep the contacts that were pressed together."""
        before, now = moments
        if len(rows) == 0 or not len(now.spin) or len(self.frames) >= MOST_FRAMES:
            return
        n, dt = len(setup), now.time - before.time
        i, j = near.pairs[rows].T
        second = np.minimum(j, n - 1)
        of_second = (j < n) & ~setup.fixed[second]
        body = np.where(of_second, second, i)  # the body whose momentum gives the impulse
        sign = np.where(of_second, 1.0, -1.0)[:, None]
        mass = setup.mass[body]
        J = sign * mass[:, None] * (now.velocity[body] - before.velocity[body] - setup.gravity * dt)
        noise = ROUNDED * mass * np.maximum(lengths(before.velocity[body]), lengths(now.velocity[body]))
        normals = near.possible_normals(rows)
        along = np.array([np.einsum("ij,ij->i", J, normal) for normal in normals])
        across = np.sqrt(np.maximum(np.einsum("ij,ij->i", J, J) - along**2, 0.0))
        slips = [_slip(setup, moment, i, j, normal) for normal in normals for moment in moments]
        slides = (np.array([lengths(slip) for slip in slips]) > SLIDING * slow).all(axis=0)
        # if the slip changes its direction in a frame, it was zero at some time in the frame
        slides &= np.einsum("ij,ij->i", slips[0], slips[-1]) > 0.0
        pressed = along.min(axis=0) > np.maximum(CLEAR * noise, 0.0)
        if not pressed.any():
            return
        J_n, J_t, noise = along[:, pressed], across[:, pressed], noise[pressed]
        least = np.maximum(J_t.min(axis=0) - noise, 0.0) / (J_n.max(axis=0) + noise)
        most = (J_t.max(axis=0) + noise) / (J_n.min(axis=0) - noise)
        strikes = (closing[rows] > slow)[pressed]
        self.frames.append(
            RubbedFrame(*place, np.stack([i, j], axis=1)[pressed], least, most, slides[pressed], strikes)
        )

    def concluded(self, bodies: int) -> Iterator[BrokenThen]:
        """Yield the contacts whose friction differs from μ."""
        if not self.frames:
            return
        ends = np.concatenate([frame.ends for frame in self.frames])
        least, most = (np.concatenate([getattr(frame, name) for frame in self.frames]) for name in ("least", "most"))
        slides, strikes = (np.concatenate([getattr(f, name) for f in self.frames]) for name in ("slides", "strikes"))
        owner = np.repeat(np.arange(len(self.frames)), [len(frame.ends) for frame in self.frames])
        pair = np.unique(ends, axis=0, return_inverse=True)[1].ravel()
        order = np.argsort(pair, kind="stable")  # sorted by pair, then by time
        goes_on = np.zeros(len(pair), bool)
        goes_on[order[:-1]] = (pair[order[:-1]] == pair[order[1:]]) & slides[order[1:]]
        # The friction of a soft contact falls in the step in which the slide ends, and Box3D applies restitution
        # without friction, so that impacts have μ / (1 + e).
        most = np.where(goes_on & ~strikes, most, np.inf)
        for among in _comparable(ends, pair, slides, bodies):
            for k, usual, excess in _wrong(ends[among], least[among], most[among], slides[among], bodies):
                row, frame = among[k], self.frames[owner[among[k]]]
                ratio = float(least[row] if least[row] > usual else most[row])
                what = f"rub with {ratio:.3g} of their normal impulse; other sliding contacts have {usual:.3g}"
                named = int(ends[row, 0]), int(ends[row, 1])
                yield frame.step, frame.time, Broken(FRICTION, excess, named, what)


def _comparable(ends: IntArray, pair: IntArray, slides: BoolArray, bodies: int) -> Iterator[IntArray]:
    """Yield the rows whose ratios are compared: of a pair that slides for long, else of a plane, or of all bodies."""
    long = np.bincount(pair, slides) >= FEWEST
    # a number for each pair that slides for long, for each plane, and one for all other contacts between bodies
    kind = np.where(long[pair], ends.max() + pair, np.maximum(ends[:, 1] - bodies, -1))
    for each in np.unique(kind).tolist():
        yield np.flatnonzero(kind == each)


def _wrong(
    ends: IntArray, least: FloatArray, most: FloatArray, slides: BoolArray, bodies: int
) -> Iterator[tuple[int, float, float]]:
    """Yield the rows whose ratio is unusual, the usual ratio, and the violation divided by the tolerance.

    Bodies may have different materials, so a contact is judged only if each of its bodies also slides with the usual
    ratio.
    """
    ratio = np.where(np.isfinite(most), 0.5 * (least + most), least)
    if np.count_nonzero(slides) < FEWEST:
        return
    usual = float(np.median(ratio[slides]))
    spread = float(np.quantile(np.abs(ratio[slides] - usual), MOSTLY))
    if not spread < EXACT * usual:
        return
    allowed = max(OFF * usual, SPREADS * spread)
    off = np.where(slides, np.maximum(least - usual, usual - most), least - usual)
    above = ~slides & (off > allowed)
    if np.count_nonzero(above) > RARELY * np.count_nonzero(~slides):
        off[above] = 0.0
    right = set(ends[slides & (off <= allowed)].ravel().tolist())
    for k in np.flatnonzero(off > allowed).tolist():
        if all(end in right for end in ends[k].tolist() if end < bodies):
            yield k, usual, float(off[k]) / allowed


def _slip(setup: Setup, moment: EngineMoment, i: IntArray, j: IntArray, normal: FloatArray) -> FloatArray:
    """Return the tangential velocities of the second surfaces relative to the first surfaces, (m, 3) m/s."""
    n = len(setup)
    second, is_body = np.minimum(j, n - 1), (j < n)[:, None]
    slip = -moment.velocity[i] - setup.radius[i][:, None] * cross(moment.spin[i], normal)
    other = moment.velocity[second] - setup.radius[second][:, None] * cross(moment.spin[second], normal)
    slip = slip + np.where(is_body, other, 0.0)
    return np.asarray(slip - np.einsum("ij,ij->i", slip, normal)[:, None] * normal)
