"""Wall time by part of the step."""

from __future__ import annotations

from time import perf_counter_ns


class Profile:
    """Sums wall time by part of the step. Marking the end of a part costs one clock reading."""

    def __init__(self) -> None:
        self._nanoseconds: dict[str, int] = {}
        self._last = 0

    def start(self) -> None:
        """Begin a step."""
        self._last = perf_counter_ns()

    def mark(self, part: str) -> None:
        """Add the time since the last mark to a part."""
        now = perf_counter_ns()
        self._nanoseconds[part] = self._nanoseconds.get(part, 0) + now - self._last
        self._last = now

    def clear(self) -> None:
        """Discard all times, such as those of the warm-up, which compiles kernels."""
        self._nanoseconds.clear()

    def seconds(self) -> dict[str, float]:
        """Return the seconds spent in each part, in the order of the step."""
        return {part: spent * 1e-9 for part, spent in self._nanoseconds.items()}
