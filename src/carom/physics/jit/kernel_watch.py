"""The time spent on loading or compiling kernels: a run spends it once, not in every step."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from carom.physics.jit.inside import event

COMPILED = "numba:compile"
LOADED_OR_COMPILED = "numba:compiler_lock"  # Numba holds this lock while it loads or compiles


class KernelWatch(event.Listener):  # type: ignore[misc] # untyped, like Numba's internals
    """Measures the time spent on loading or compiling kernels while it is active, and counts the compiled kernels.

    ``clock`` returns seconds.
    """

    def __init__(self, clock: Callable[[], float]) -> None:
        self.compiled = 0  # number of compiled kernels; the others came from the cache
        self._clock = clock
        self._seconds = dict.fromkeys((COMPILED, LOADED_OR_COMPILED), 0.0)
        self._since = dict(self._seconds)
        # depth of nesting, since kernels load and compile the kernels that they call
        self._depth = dict.fromkeys(self._seconds, 0)

    @property
    def seconds(self) -> float:
        """Seconds in which kernels were loaded or compiled."""
        return self._seconds[LOADED_OR_COMPILED]

    @property
    def loading(self) -> float:
        """Seconds in which kernels were loaded."""
        return self.seconds - self.compiling

    @property
    def compiling(self) -> float:
        """Seconds in which kernels were compiled."""
        return self._seconds[COMPILED]

    def __enter__(self) -> KernelWatch:
        for kind in self._seconds:
            event.register(kind, self)
        return self

    def __exit__(self, *error: object) -> None:
        for kind in self._seconds:
            event.unregister(kind, self)

    def on_start(self, begun: Any) -> None:
        """Start the clock at the outermost kernel, and count a compilation."""
        self.compiled += begun.kind == COMPILED
        if not self._depth[begun.kind]:
            self._since[begun.kind] = self._clock()
        self._depth[begun.kind] += 1

    def on_end(self, ended: Any) -> None:
        """Stop the clock after the outermost kernel."""
        self._depth[ended.kind] -= 1
        if not self._depth[ended.kind]:
            self._seconds[ended.kind] += self._clock() - self._since[ended.kind]
