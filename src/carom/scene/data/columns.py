"""`BodyColumns`: the bodies of one [[bodies]], as arrays."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from carom.arrays import BoolArray, FloatArray


@dataclass(frozen=True, eq=False)
class BodyColumns:
    """Bodies at time 0, in the order of the file; SI units. The arrays are not to be changed."""

    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    angular_velocity: FloatArray  # (n, 3) rad/s
    mass: FloatArray  # (n,) kg
    radius: FloatArray  # (n,) m
    inertia: FloatArray  # (n,) kg m²
    fixed: BoolArray  # (n,)
    name: list[str] | None = None  # (n,); None: they are numbered

    def __len__(self) -> int:
        return len(self.mass)

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, BodyColumns):
            return NotImplemented
        return self.name == other.name and all(
            np.array_equal(getattr(self, field.name), getattr(other, field.name))
            for field in fields(self)
            if field.name != "name"
        )

    __hash__ = None  # type: ignore[assignment]

    @cached_property
    def radii(self) -> tuple[float, float]:
        """The smallest and the largest radius in m."""
        return float(self.radius.min()), float(self.radius.max())

    @cached_property
    def heaviest(self) -> int:
        """Number of the heaviest body."""
        return int(np.argmax(self.mass))

    @cached_property
    def massless(self) -> int:
        """How many have no mass."""
        return int(np.count_nonzero(self.mass == 0.0))

    @cached_property
    def total_mass(self) -> float:
        """The mass of all in kg."""
        return math.fsum(self.mass.tolist())

    @cached_property
    def spins(self) -> bool:
        """Whether a body has an angular velocity."""
        return bool(np.any(self.angular_velocity))

    @cached_property
    def anchors(self) -> bool:
        """Whether a body is fixed."""
        return bool(np.any(self.fixed))

    @cached_property
    def common_velocity(self) -> tuple[float, ...] | None:
        """The velocity in m/s if all bodies have the same."""
        first = self.velocity[0]
        return tuple(first.tolist()) if np.all(self.velocity == first) else None

    @cached_property
    def sha256(self) -> str:
        """A digest of the arrays, for bodies that come from no file."""
        digest = hashlib.sha256()
        for field in fields(self):
            values = getattr(self, field.name)
            data = "\0".join(values or ()).encode() if field.name == "name" else np.ascontiguousarray(values).data
            digest.update(f"{field.name} {len(self)}\n".encode())
            digest.update(data)
        return digest.hexdigest()
