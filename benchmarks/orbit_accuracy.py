"""Measures whether many orbits keep the requested accuracy, by Kepler's equation.

    python benchmarks/orbit_accuracy.py --json results/orbit_accuracy.json     # a quarter of an hour
    python benchmarks/orbit_accuracy.py --periods 10,100 --requests 1e-4,1e-8

Two bodies of equal mass go around each other with gauss-radau15, on one thread, from the apocentre on. The error is the
largest rms distance from the solution over the size of the system, at 41 times up to the horizon that the run states.
"""

from __future__ import annotations

import argparse
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.physics.schedule import at
from carom.physics.space import Space
from carom.scene.load import Scene

ROOT = Path(__file__).parent
ECCENTRICITIES = (0.0, 0.3, 0.6, 0.9)
SAMPLES = 41  # a prime number, so that they are at different phases
ITERATIONS = 60  # of Newton's method for Kepler's equation; some ten reach rounding


def orbit(eccentricity: float, periods: float, request: float) -> Scene:
    """Return two bodies of semi-major axis 1 and G m = 1 for some periods of 2 π."""
    away, speed = 1.0 + eccentricity, math.sqrt((1.0 - eccentricity) / (1.0 + eccentricity))
    bodies = [
        {"mass": 0.5, "radius": 1e-4, "position": [side * away / 2, 0, 0], "velocity": [0, side * speed / 2, 0]}
        for side in (-1.0, 1.0)
    ]
    duration = 2.0 * math.pi * periods
    time = {"duration": duration, "accuracy": request, "max_dt": 1e6, "integrator": "gauss-radau15"}
    return Scene.from_dict({"time": time, "gravity": {"constant": 1.0}, "contact": {"enabled": False}, "body": bodies})


def separation(eccentricity: float, time: float) -> NDArray[np.float64]:
    """Return the second body as the first one sees it, (3,) m."""
    mean = math.remainder(time - math.pi, 2.0 * math.pi)
    anomaly = mean + math.copysign(0.85 * eccentricity, mean)  # Danby 1988
    for _ in range(ITERATIONS):
        missing = anomaly - eccentricity * math.sin(anomaly) - mean
        anomaly -= missing / (1.0 - eccentricity * math.cos(anomaly))
    across = math.sqrt(1.0 - eccentricity * eccentricity) * math.sin(anomaly)
    return np.array([eccentricity - math.cos(anomaly), -across, 0.0])


def measure(eccentricity: float, periods: float, request: float) -> dict[str, Any]:
    """Run an orbit and compare it."""
    space = Space(orbit(eccentricity, periods, request), 1)
    promise, size, error = space.scene.promise, (1.0 + eccentricity) / 2.0, 0.0
    assert promise is not None
    for time in (promise.kept_until * np.arange(1, SAMPLES + 1) / SAMPLES).tolist():
        for _ in space.run(time, schedule=at(())):
            pass
        x = space.state.position
        missed = np.linalg.norm(x[1] - x[0] - separation(eccentricity, time)) / 2.0  # each by half of it
        error = max(error, float(missed) / size)
    return {
        "eccentricity": eccentricity,
        "periods": periods,
        "request": request,
        "refinement": promise.refinement,
        "kept_until": promise.kept_until / space.scene.time.duration,
        "named": promise.error[-1],
        "error": error,
        "kept": error <= request,
    }


def main() -> None:
    """Print a row per orbit and request, and write them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--periods", default="10,100,1000,10000")
    parser.add_argument("--requests", default="1e-2,1e-4,1e-6,1e-8")
    parser.add_argument("--json", help="file to write")
    given = parser.parse_args()
    rows = []
    for eccentricity in ECCENTRICITIES:
        for periods in map(float, given.periods.split(",")):
            for request in map(float, given.requests.split(",")):
                rows.append(measure(eccentricity, periods, request))
                print({k: f"{v:.3g}" if isinstance(v, float) else v for k, v in rows[-1].items()}, flush=True)
    print(f"{sum(row['kept'] for row in rows)} of {len(rows)} kept")
    if given.json:
        (ROOT / given.json).write_text("[\n" + ",\n".join(map(json.dumps, rows)) + "\n]\n", encoding="utf-8")


if __name__ == "__main__":
    main()
