"""Quantities of a settled pile, which are compared once chaos ends the comparison of trajectories.

No two runs of a pile agree in where each body ends. Within the scatter between seeds, runs do agree in the pile's
height, density, number of contacts and energy, and in the time in which the pile comes to rest. This scatter is the
uncertainty of the errors of a pile: a setting whose pile differs by less than the scatter is as good as any other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from carom.arrays import FloatArray
from carom.lab.compared_run import Trajectory
from carom.physics.placement import place
from carom.physics.vector import minimum_images
from carom.plan.features import require
from carom.scene.load import Scene

SEEDS = 4  # number of runs with other seeds that measure the scatter
TOUCHING = 1e-3  # largest gap of a contact, relative to the smaller radius
AT_REST = 1e-6  # fraction of the largest kinetic energy below which a pile is at rest


class Settled(NamedTuple):
    """The settled state of a run."""

    height: float  # m, height of the centre of mass above the lowest point
    density: float  # fraction of a box that the bodies fill; the box is twice as high as their centre of volume
    coordination: float  # contacts with other bodies, per body
    settled_energy: float  # J, kinetic energy and energy in the field
    rest_time: float  # s, time from which the kinetic energy stays below `AT_REST`; the end of the run if it never does


@dataclass(frozen=True, slots=True)
class Pile:
    """The bodies of a scene that settle in a uniform field."""

    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    field: FloatArray  # (3,) m/s²
    box: FloatArray | None  # (3,) m, size of a periodic domain

    @classmethod
    def of(cls, scene: Scene) -> Pile | None:
        """Return the pile of a scene; None if its bodies do not settle, or if no seed places them."""
        field, needs = np.array(scene.gravity.uniform), require(scene)
        if not (field.any() and needs.resting.modelled and scene.group):
            return None
        start, period = place(scene), scene.domain.period
        return cls(start.mass, start.radius, field, None if period is None else np.array(period))

    def settled(self, run: Trajectory) -> Settled:
        """Measure the end of a run."""
        strength = float(np.linalg.norm(self.field))
        up, x = -self.field / strength, run.position[-1]
        along = x @ up
        lowest = float((along - self.radius).min())
        volume = 4.0 / 3.0 * np.pi * self.radius**3
        height = float(np.average(along, weights=self.mass)) - lowest
        sides = np.linalg.svd(up[np.newaxis])[2][1:]  # two horizontal directions
        across = [float((x @ side + self.radius).max() - (x @ side - self.radius).min()) for side in sides]
        middle = float(np.average(along, weights=volume)) - lowest
        kinetic = 0.5 * np.sum(self.mass * np.sum(run.velocity**2, axis=2), axis=1)  # (K,)
        moves = np.flatnonzero(kinetic > AT_REST * kinetic.max())
        rested = min(int(moves[-1]) + 1 if len(moves) else 0, len(run) - 1)
        return Settled(
            height=height,
            density=float(volume.sum()) / (across[0] * across[1] * 2.0 * middle),
            coordination=2.0 * self._contacts(x) / len(x),
            settled_energy=float(kinetic[-1]) + strength * float(self.mass.sum()) * height,
            rest_time=float(run.time[rested]),
        )

    def errors(self, run: Trajectory, reference: Trajectory) -> dict[str, float]:
        """Return the differences of the settled states: relative to the reference, in contacts per body, or in s."""
        if len(run) < len(reference):
            return {}
        found, exact = self.settled(run), self.settled(reference)
        return {
            name: abs(a - b) / (abs(b) if name in RELATIVE else 1.0)
            for name, a, b in zip(Settled._fields, found, exact, strict=True)
        }

    def scatter(self, others: list[Settled], reference: Trajectory) -> dict[str, float]:
        """Return the standard deviations between a reference and runs with other seeds, in the units of the errors.

        The time to rest is uncertain by at least the time between two samples.
        """
        exact, scattered = self.settled(reference), {}
        for name in Settled._fields:
            values = [getattr(each, name) for each in (exact, *others)]
            scattered[name] = float(np.std(values, ddof=1)) / (abs(values[0]) if name in RELATIVE else 1.0)
        scattered["rest_time"] = max(scattered["rest_time"], float(reference.time[-1]) / len(reference))
        return scattered

    def _contacts(self, x: FloatArray) -> int:
        """Return the number of pairs that touch."""
        count = 0
        for i in range(len(x) - 1):
            apart = x[i + 1 :] - x[i]
            if self.box is not None:
                apart = minimum_images(apart, self.box)
            gap = np.linalg.norm(apart, axis=1) - self.radius[i] - self.radius[i + 1 :]
            count += int(np.count_nonzero(gap <= TOUCHING * np.minimum(self.radius[i], self.radius[i + 1 :])))
        return count


RELATIVE = ("height", "density", "settled_energy")  # errors that are relative to the reference's value
