"""`once_a_scene`: a decision about a scene, made when it is first needed.

A run of three bodies asked 140 times whether anything can touch, and 50 times for the integrator. Finding the answers
took half of the time to set up a second `Space`. Scenes are immutable, so an answer is valid as long as its scene
exists.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable
from functools import wraps
from typing import TypeVar

from carom.scene.load import Scene

Answer = TypeVar("Answer")


def once_a_scene(decide: Callable[[Scene], Answer]) -> Callable[[Scene], Answer]:
    """Cache the results of a function whose only argument is a scene; exceptions are not cached."""
    answers: dict[int, tuple[weakref.ref[Scene], Answer]] = {}  # answers by the address of the scene

    @wraps(decide)
    def decided(scene: Scene) -> Answer:
        address = id(scene)
        kept = answers.get(address)
        if kept is not None and kept[0]() is scene:
            return kept[1]
        answer = decide(scene)
        # Rejected: callbacks of the weak references. Python drops exceptions raised in such a callback, even Ctrl-C.
        for gone in [each for each, (reference, _) in answers.items() if reference() is None]:
            del answers[gone]
        answers[address] = weakref.ref(scene), answer
        return answer

    return decided
