"""The progress of the compilation of kernels: the number of ready and of needed kernels, and the remaining time."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import cache
from typing import Any

from carom.physics.jit.decorators import Compilations
from carom.plan.features import require
from carom.scene.load import Scene
from carom.terminal.console import LINE_EVERY, LiveLine, bar

# Numbers of kernels that `kernels_ready` counts at the end of the bundled scenes; `test_compilation_progress.py`
# compares the numbers.
POINTS = 11  # in scenes without contacts, such as figure-eight
IMPACTS = 129  # in scenes whose contacts are impacts, such as two-spheres
FORCES = 163  # in scenes in which forces press bodies together, such as heap
LEAST = 5  # number of kernels after which their rate is meaningful


class CompilationProgress(Compilations):
    """Shows the progress of a compilation: in the live line of a run, or else by one line per `LINE_EVERY` seconds.

    Parameters
    ----------
    scene
        The scene that is run; without one, the kernels of a scene with forces are expected.
    say
        Prints a line where no live line is shown.
    """

    def __init__(self, scene: Scene | None, say: Callable[[str], None]) -> None:
        super().__init__()
        self._needed = FORCES if scene is None else kernels_needed(scene)
        self._say = say
        self._began = self._last_line = time.perf_counter()
        self._had = kernels_ready()  # number of kernels that were ready at the start
        self._depth = 0  # number of kernels being compiled; each is needed for the previous one
        LiveLine.interlude = self.interlude

    def on_start(self, event: object) -> None:
        """Count a kernel, and print a line if one is due."""
        super().on_start(event)
        self._depth += 1
        now = time.perf_counter()
        if not LiveLine.is_live and now - self._last_line >= LINE_EVERY:
            self._last_line = now
            self._say(self.text(now))

    def on_end(self, event: object) -> None:
        """Note that a kernel is compiled, or that its compilation failed."""
        self._depth = max(0, self._depth - 1)  # the event of the first kernel may have been missed

    def interlude(self, now: float) -> str:
        """Return the text that replaces the text of a live line, at a time of the clock (s); empty between kernels."""
        ready, needed = self._counts()
        return f"{bar(ready / needed)} {self.text(now)}" if self._depth else ""

    def text(self, now: float) -> str:
        """Describe the progress at a time of the clock (s). The time left is estimated from the rate so far."""
        ready, needed = self._counts()
        text = f"Compiling: {self.counts()} kernels"
        if (made := ready - self._had) >= LEAST:
            left = (now - self._began) / made * (needed - ready)
            text += f", about {float(f'{left:.2g}'):g} s left"
        return text

    def counts(self) -> str:
        """State the numbers of ready and of needed kernels."""
        ready, needed = self._counts()
        return f"{ready} of about {needed}"

    def _counts(self) -> tuple[int, int]:
        ready = kernels_ready()
        return ready, max(self._needed, ready)


def kernels_needed(scene: Scene) -> int:
    """Return the approximate number of kernels that a run of a scene needs."""
    needs = require(scene)
    if not needs.contact.modelled:
        return POINTS
    return FORCES if needs.resting.modelled else IMPACTS


def kernels_ready() -> int:
    """Return the number of kernels that this process has: compiled, loaded, or part of a loaded kernel."""
    found = set[Any]()
    waiting = [kernel for name in list(sys.modules) for kernel in _kernels_of(name) if kernel.overloads]
    while waiting:
        kernel = waiting.pop()
        if kernel not in found:
            found.add(kernel)
            waiting += _called_by(kernel)
    return len(found)


def _kernels_of(module: str) -> list[Any]:
    """Return the kernels that a module of carom names, except kernels that are inlined into others."""
    if not module.startswith("carom."):
        return []
    return [each for each in list(vars(sys.modules[module]).values()) if _is_kernel(each)]


@cache
def _called_by(kernel: Any) -> list[Any]:
    """Return the kernels that a kernel names."""
    function = kernel.py_func
    named = [function.__globals__.get(name) for name in function.__code__.co_names]
    enclosed = [cell.cell_contents for cell in function.__closure__ or ()]
    return [each for each in named + enclosed if _is_kernel(each)]


def _is_kernel(thing: Any) -> bool:
    return hasattr(thing, "py_func") and thing.targetoptions.get("inline") != "always"
