"""What every method that sums gravity offers."""

from __future__ import annotations

from typing import Protocol

from carom.arrays import FloatArray


class Pull(Protocol):
    """Gravity of n bodies on each other, with its workspace."""

    def accelerate(self, position: FloatArray, acceleration: FloatArray, potential: bool) -> float | None:
        """Write the acceleration of every body; return the potential energy in joules if requested.

        Parameters
        ----------
        position
            (n, 3) m.
        acceleration
            (n, 3) m/s², overwritten.
        potential
            Whether to return the energy, too.
        """
