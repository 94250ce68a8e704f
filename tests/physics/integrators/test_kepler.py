"""The solver of the Kepler problem against solutions in 40 digits."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from carom.physics.integrators.wisdom_holman.kepler import LANES, WORKSPACE, revolve, revolve_all
from carom.physics.jit.decorators import kernel

FloatArray = NDArray[np.float64]


@kernel
def one(x: FloatArray, v: FloatArray, h: float) -> None:
    revolve(x, v, 0, 1.0, h)


@kernel
def many(x: FloatArray, v: FloatArray, mu: FloatArray, h: float, lanes: FloatArray) -> None:
    revolve_all(x, v, mu, h, lanes)


def at_anomaly(e: float, angle: float) -> tuple[FloatArray, FloatArray]:
    """Position and velocity on an orbit of semi-major axis 1 about G M = 1; of a parabola, of parameter 1."""
    p = abs(1.0 - e * e) or 1.0
    r = p / (1.0 + e * np.cos(angle))
    x = np.array([r * np.cos(angle), r * np.sin(angle), 0.1 * r])
    return x, np.array([-np.sin(angle), e + np.cos(angle), 0.05]) / np.sqrt(p)


def exact(x: Any, v: Any, h: float) -> FloatArray:
    """Solve the universal Kepler equation in 40 digits; return the position."""
    with mpmath.workdps(40):
        x, v, t = [mpmath.mpf(float(c)) for c in x], [mpmath.mpf(float(c)) for c in v], mpmath.mpf(h)
        r = mpmath.sqrt(sum(c * c for c in x))
        beta = 2 / r - sum(c * c for c in v)
        eta, zeta = sum(a * b for a, b in zip(x, v, strict=True)), 1 - beta * r

        def functions(s: Any) -> tuple[Any, Any, Any]:
            root = mpmath.sqrt(abs(beta))
            sine, cosine = (mpmath.sin, mpmath.cos) if beta > 0 else (mpmath.sinh, mpmath.cosh)
            g1 = sine(root * s) / root
            return g1, (1 - cosine(root * s)) / beta, (s - g1) / beta

        def late(s: Any) -> Any:
            _, g2, g3 = functions(s)
            return r * s + eta * g2 + zeta * g3 - t

        low, high = mpmath.mpf(-1), mpmath.mpf(1)
        while late(low) > 0:
            low *= 2
        while late(high) < 0:
            high *= 2
        for _ in range(150):
            middle = (low + high) / 2
            low, high = (low, middle) if late(middle) > 0 else (middle, high)
        _, g2, g3 = functions(low)
        return np.array([float((1 - g2 / r) * a + (t - g3) * b) for a, b in zip(x, v, strict=True)])


def conditioned(x: FloatArray, v: FloatArray, h: float, place: FloatArray) -> float:
    """Return by how much a last bit in what is given changes the position, at least one of its own."""
    bit, found = 2.0**-52, 2.0**-52 * float(np.linalg.norm(place))
    for k in range(7):
        given = np.concatenate((x, v, [h]))
        given[k] *= 1.0 + 1024.0 * bit
        moved = exact(given[:3], given[3:6], float(given[6]))
        found = max(found, float(np.linalg.norm(moved - place)) / 1024.0)
    return found


ECCENTRICITIES = (0.0, 0.05, 0.9, 0.9999, 1.0001, 100.0)


@pytest.mark.parametrize("e", ECCENTRICITIES)
def test_a_step_of_any_length_is_exact_to_rounding_on_any_conic(e: float) -> None:
    rng = np.random.default_rng(5)
    widest = np.pi if e < 1.0 else 0.9 * np.arccos(-1.0 / e)
    for _ in range(3):
        x, v = at_anomaly(e, rng.uniform(-widest, widest))
        h = float(rng.choice((-1.0, 1.0)) * 10.0 ** rng.uniform(-3.0, 1.5))
        place, moved, turned = exact(x, v, h), x[None].copy(), v[None].copy()
        one(moved, turned, h)
        # some dozen roundings, each as if a last bit of what is given had changed
        assert np.linalg.norm(moved[0] - place) <= 12.0 * conditioned(x, v, h, place)


def test_bodies_side_by_side_agree_with_each_alone() -> None:
    rng = np.random.default_rng(6)
    n = 2 * LANES + 7  # more than one row of lanes, and not a multiple of four
    states = [at_anomaly(e, f) for e, f in zip(rng.uniform(0.0, 1.2, n), rng.uniform(-1.5, 1.5, n), strict=True)]
    x, v = (np.array(values) for values in zip(*states, strict=True))
    alone, turned = x.copy(), v.copy()
    mu = np.ones(n)
    many(x, v, mu, 0.05, np.zeros(WORKSPACE))
    for i in range(1, n):
        one(alone[i : i + 1], turned[i : i + 1], 0.05)
    assert np.array_equal(x[0], states[0][0])  # the first row is the centre of mass
    # both are exact to rounding, with the speed at the pericentre of the most eccentric of them
    assert np.abs(x - alone)[1:].max() <= 1e-14
    assert np.abs(v - turned)[1:].max() <= 1e-13 * np.abs(v).max()


@pytest.mark.parametrize("e", [0.1, 0.9, 1.5])
def test_a_step_back_undoes_a_step(e: float) -> None:
    x, v = at_anomaly(e, 0.7)
    moved, turned = x[None].copy(), v[None].copy()
    for h in (0.3, -0.3):
        one(moved, turned, h)
    assert np.abs(moved[0] - x).max() <= 1e-14
    assert np.abs(turned[0] - v).max() <= 2e-14
