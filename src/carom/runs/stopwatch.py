"""Clocks for measurements on a machine that other programs use, too."""

from __future__ import annotations

import time

from carom.physics.jit.kernel_watch import KernelWatch


class Stopwatch:
    """Seconds of computing since its start: wall time, or the CPU time of the process while other programs delay it."""

    def __init__(self) -> None:
        self._wall, self._computing = time.perf_counter(), time.process_time()

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return min(time.perf_counter() - self._wall, time.process_time() - self._computing)


class TrialClock:
    """Seconds of computing while it is active, without the seconds in which kernels are loaded or compiled."""

    def __init__(self) -> None:
        self._watch = Stopwatch()
        self.kernels = KernelWatch(lambda: self._watch.seconds)

    def __enter__(self) -> TrialClock:
        self.kernels.__enter__()
        return self

    def __exit__(self, *error: object) -> None:
        self.kernels.__exit__(*error)

    @property
    def all_seconds(self) -> float:
        """Seconds since the start, kernels included."""
        return self._watch.seconds

    @property
    def seconds(self) -> float:
        """Seconds since the start."""
        return self.all_seconds - self.kernels.seconds
