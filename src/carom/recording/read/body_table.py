"""`BodyTable`: the bodies of a recording."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import pyarrow as pa
from numpy.typing import NDArray

from carom.scene.wording import SomeNames


@dataclass(frozen=True, slots=True)
class BodyTable:
    """The static properties of the bodies; called with a time, their exact state at that time."""

    name: Sequence[str]  # (n,)
    group: NDArray[np.int64]  # (n,)
    mass: NDArray[np.float64]  # (n,) kg
    radius: NDArray[np.float64]  # (n,) m
    inertia: NDArray[np.float64]  # (n,) kg m²
    _states: Callable[[float | None], pa.Table] = field(repr=False, compare=False)

    def among(self, shown: Sequence[int], bodies: int) -> Self:
        """Return a table of more bodies, of which these are ``shown``; of the others nothing is known."""

        def spread(values: NDArray[np.float64]) -> NDArray[np.float64]:
            found = np.full(bodies, np.nan)
            found[shown] = values
            return found

        group = np.full(bodies, -1)
        group[shown] = self.group
        return replace(
            self,
            name=SomeNames("body", bodies, dict(zip(shown, self.name, strict=True))),
            group=group,
            mass=spread(self.mass),
            radius=spread(self.radius),
            inertia=spread(self.inertia),
        )

    def __call__(self, at: float | None = None) -> pa.Table:
        """Return the state of all bodies at the end of the step that a time is in, in float64.

        It is that of a checkpoint, or else of a replay from the checkpoint before.

        Parameters
        ----------
        at
            s, by default the moment of `Recording.moment`.

        Returns
        -------
        states
            Columns body, name, x, y, z (m), vx, vy, vz (m/s), with orientations qx, qy, qz, qw, with spins
            wx, wy, wz (rad/s). The metadata of its schema has the ``step``, the ``time`` (s) and the ``source``.

        Raises
        ------
        RecordingError
            If the time is not in the recording, or it cannot be run again.
        """
        return self._states(at)
