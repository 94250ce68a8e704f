"""Dense random packings: compression by FIRE, as scenes have it, beside growth after Lubachevsky and Stillinger.

    python benchmarks/packing.py [--bodies N ...] [--packing P ...]

Equal spheres of radius 1 m in a periodic box; both methods begin with the same random start at a packing of 0.2.

FIRE is `carom.scene.placement.compression`. Growth by events (J. Stat. Phys. 60, 561): spheres fly straight and bounce
elastically while all radii grow at one rate, and speeds are scaled back to 1 m/s per axis after each pass. The times
are carom's own: with the sum of radii D (1 + k t), the time s of impact follows from that of spheres of constant size,

    |x + v s| = D (1 + k s)   ⟺   |x + (v - k x) σ| = D,   s = σ / (1 - k σ)

and the event queue is that of the drift. Times are CPU seconds with warm kernels. `near` is the mean number of
neighbours nearer than 1.01 diameters; `overlap` is the deepest one over the radius.
"""

from __future__ import annotations

import argparse
import math
import time
from collections.abc import Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.contact.broad_phase.hierarchical_grid import HierarchicalGrid
from carom.physics.contact.continuous.drift import _both_ways
from carom.physics.contact.continuous.event_queue import put
from carom.physics.contact.continuous.time_of_impact import time_of_impact
from carom.physics.contact.continuous.trajectories import TRAJECTORY
from carom.physics.parallel.jit import kernel
from carom.physics.periodic_box import minimum_image
from carom.scene.half_space import HalfSpaces
from carom.scene.neighbours import overlapping_pairs
from carom.scene.placement.compression import compressed, shrunken
from carom.scene.placement.random_placement import positions
from carom.scene.placement.surroundings import Surroundings
from carom.scene.schema import Region
from measurement import merge

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SIZES, PACKINGS = [1000, 10_000, 100_000], [0.3, 0.4, 0.5, 0.6]
RATES = [1.0, 0.1]  # m/s, of the radii; the speeds are 1 m/s per axis
SKIN = 0.3  # m, that a sphere may move until neighbours are searched again
PASS = 0.1  # s, at most
MOST_IMPACTS = 3000  # of a sphere, on the average; more is a jam
NOTHING = HalfSpaces([], np.empty((0, 3)), np.empty(0))


def grown(start: FloatArray, radius: float, side: float, rate: float, seed: int) -> FloatArray:
    """Let spheres grow to a radius of 1 m; return their centres, (n, 3) m."""
    n, box = len(start), np.full(3, side)
    x, v = start.copy(), np.random.default_rng(seed).standard_normal(start.shape)
    body, queue, impacts = np.zeros(n, TRAJECTORY), np.empty(n, dtype=np.int64), 0
    while radius < 1.0:
        v -= v.mean(axis=0)
        v /= math.sqrt(float((v * v).mean()))
        span = min(PASS, (1.0 - radius) / rate)
        pairs = HierarchicalGrid(np.full(n, radius), box).pairs(x, 1.0, 2.0 * (rate * span + SKIN))
        ends, others = np.zeros(n + 1, dtype=np.int64), np.empty(2 * len(pairs), dtype=np.int64)
        _both_ways(pairs, ends, others)
        flown, count = _fly(x, v, body, queue, ends, others, side, 2.0 * radius, 2.0 * rate, span)
        impacts += count
        radius = 1.0 if flown == (1.0 - radius) / rate else radius + rate * flown
        x -= side * np.floor(x / side + 0.5)
        if 2 * impacts > MOST_IMPACTS * n:
            raise RuntimeError(f"jammed at a radius of {radius:.4f}")
    return x


@kernel
def _fly(
    x: FloatArray,
    v: FloatArray,
    body: NDArray[np.void],
    queue: IntArray,
    ends: IntArray,
    others: IntArray,
    side: float,
    D: float,
    growth: float,
    span: float,
) -> tuple[float, int]:
    """Fly until a sphere has left its skin, at most for a span; return the time in s, and the number of impacts."""
    n, size, impacts = len(x), 0, 0
    for i in range(n):
        body[i].now, body[i].impacts, body[i].queue_place = 0.0, 0, -1
        body[i].start_x, body[i].start_y, body[i].start_z = x[i, 0], x[i, 1], x[i, 2]
        span = min(span, SKIN / np.sqrt(v[i, 0] ** 2 + v[i, 1] ** 2 + v[i, 2] ** 2))
    for i in range(n):
        _predict(i, 0.0, x, v, body, ends, others, side, D, growth, span)
        size = put(i, size, queue, body)
    while size > 0 and body[queue[0]].impact_time < span:
        i = queue[0]
        j, now = body[i].partner, body[i].impact_time
        if body[j].impacts == body[i].partner_impacts:
            impacts += 1
            for b in (i, j):
                for k in range(3):
                    x[b, k] += v[b, k] * (now - body[b].now)
                body[b].now = now
                body[b].impacts += 1
            nx, ny, nz = x[j, 0] - x[i, 0], x[j, 1] - x[i, 1], x[j, 2] - x[i, 2]
            nx, ny, nz = minimum_image(nx, side), minimum_image(ny, side), minimum_image(nz, side)
            d2 = nx * nx + ny * ny + nz * nz
            vn = ((v[j, 0] - v[i, 0]) * nx + (v[j, 1] - v[i, 1]) * ny + (v[j, 2] - v[i, 2]) * nz) / np.sqrt(d2)
            J = (growth - vn) / np.sqrt(d2)  # the surfaces rebound at the speed at which they closed
            for k, along in enumerate((nx, ny, nz)):
                v[i, k] -= J * along
                v[j, k] += J * along
            for b in (i, j):
                span = min(span, now + _leaves(x[b], v[b], body[b]))
            _predict(j, now, x, v, body, ends, others, side, D, growth, span)
            size = put(j, size, queue, body)
        _predict(i, now, x, v, body, ends, others, side, D, growth, span)
        size = put(i, size, queue, body)
    for i in range(n):
        for k in range(3):
            x[i, k] += v[i, k] * (span - body[i].now)
    return span, impacts


@kernel
def _leaves(x: FloatArray, v: FloatArray, body: Any) -> float:
    """Return in how many s a sphere leaves its skin."""
    ox, oy, oz = x[0] - body.start_x, x[1] - body.start_y, x[2] - body.start_z
    v2, ov = v[0] * v[0] + v[1] * v[1] + v[2] * v[2], ox * v[0] + oy * v[1] + oz * v[2]
    room = max(0.0, SKIN * SKIN - (ox * ox + oy * oy + oz * oz))
    return float((np.sqrt(ov * ov + v2 * room) - ov) / v2)


@kernel
def _predict(
    i: int,
    now: float,
    x: FloatArray,
    v: FloatArray,
    body: NDArray[np.void],
    ends: IntArray,
    others: IntArray,
    side: float,
    D: float,
    growth: float,
    span: float,
) -> None:
    """Predict the next impact of a sphere."""
    D += growth * now
    k, left = growth / D, span - now
    body[i].impact_time = np.inf
    for m in range(ends[i], ends[i + 1]):
        j = others[m]
        s, t = now - body[i].now, now - body[j].now
        vx, vy, vz = v[j, 0] - v[i, 0], v[j, 1] - v[i, 1], v[j, 2] - v[i, 2]
        dx = minimum_image((x[j, 0] + v[j, 0] * t) - (x[i, 0] + v[i, 0] * s), side)
        dy = minimum_image((x[j, 1] + v[j, 1] * t) - (x[i, 1] + v[i, 1] * s), side)
        dz = minimum_image((x[j, 2] + v[j, 2] * t) - (x[i, 2] + v[i, 2] * s), side)
        wx, wy, wz = vx - k * dx, vy - k * dy, vz - k * dz
        sigma = time_of_impact(dx, dy, dz, wx, wy, wz, 0.0, 0.0, 0.0, D, left / (1.0 + k * left), 0.0, 0.0)
        when = now + sigma / (1.0 - k * sigma) if sigma < np.inf else np.inf
        if when < body[i].impact_time:
            body[i].impact_time, body[i].partner, body[i].partner_impacts = when, j, body[j].impacts


def fire(loose: FloatArray, side: float) -> FloatArray:
    """Compress as a scene does; return the centres, (n, 3) m."""
    region = Region(shape="box", size=(side, side, side))
    return compressed(0, region, loose, np.ones(len(loose)), Surroundings((), NOTHING, np.full(3, side)))


def rows(n: int, packing: float) -> Iterator[dict[str, Any]]:
    """Measure both methods twice, and what they made."""
    side = float(np.cbrt(n * 4.0 / 3.0 * math.pi / packing))
    small, box = shrunken(np.ones(n), packing), np.full(3, side)
    region = Region(shape="box", size=(side, side, side))
    loose = positions(0, region, small, Surroundings((), NOTHING, box), np.random.default_rng(0))
    methods = {"FIRE": partial(fire, loose, side)}
    methods |= {f"growth at {rate:g} m/s": partial(grown, loose, float(small[0]), side, rate, 1) for rate in RATES}
    for name, method in methods.items():
        began = time.process_time()
        x, again, spent = method(), method(), 0.5 * (time.process_time() - began)
        near = overlapping_pairs(x, np.full(n, 1.01), box)
        d = x[near[:, 1]] - x[near[:, 0]]
        d -= side * np.round(d / side)
        overlap = 2.0 - min(2.0, float(np.sqrt((d * d).sum(axis=1)).min(initial=2.0)))
        measured = {"seconds": spent, "overlap": overlap, "near": 2.0 * len(near) / n}
        yield (
            {"method": name, "bodies": n, "packing": f"{packing:g}"}
            | measured
            | {"same_bits": bool((x == again).all())}
        )


def main() -> None:
    parser = argparse.ArgumentParser(description="Dense random packings by FIRE and by growth.")
    parser.add_argument("--bodies", type=int, nargs="+", default=SIZES)
    parser.add_argument("--packing", type=float, nargs="+", default=PACKINGS)
    chosen = parser.parse_args()
    grown(np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0]]), 0.9, 9.0, 1.0, 0)  # loads the kernels
    for n in chosen.bodies:
        for packing in chosen.packing:
            for row in rows(n, packing):
                print(
                    f"{row['bodies']:>7} {row['packing']:>4} {row['method']:<18} {row['seconds']:8.2f} CPU s, "
                    f"overlap {row['overlap']:.1e}, {row['near']:.2f} near, same bits: {row['same_bits']}",
                    flush=True,
                )
                merge("packing", {"rows": [row]})


if __name__ == "__main__":
    main()
