"""The random scenes of `carom hunt` as strategies of Hypothesis, which shrinks a failure to something to read."""

from __future__ import annotations

from functools import cache, lru_cache
from typing import Any, TypeVar

import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

from carom.lab.hunt.documents import DIRECTIONS, QUARTERS, Document, impacts, meeting, smooth
from carom.scene.load import Scene

Value = TypeVar("Value")

EPS = float(np.finfo(np.float64).eps)


def scene_from(document: Document) -> Scene:
    """Validate a document. `Scene.from_dict` also writes its TOML, which takes 20 times as long and moves nothing."""
    return Scene.model_validate(document)


@lru_cache(None, typed=True)  # True is not 1.0
def choices(*values: Any) -> st.SearchStrategy[Any]:
    """Draw one of these. A strategy is costly to build, and so each is built once."""
    return st.sampled_from(values)


@cache
def decades(low: int, high: int) -> st.SearchStrategy[float]:
    """Draw from 10^low to 10^high, four values a decade."""
    return st.integers(4 * low, 4 * high).map(lambda k: float(10.0 ** (k / 4)))


_numbers = cache(st.integers)
vectors = st.integers(0, len(QUARTERS) - 1).map(lambda k: QUARTERS[k])
directions = st.integers(0, len(DIRECTIONS) - 1).map(lambda k: DIRECTIONS[k])
parts = st.integers(0, 8).map(lambda k: k / 8)  # of one


class _Draw:
    """Draws by Hypothesis."""

    def __init__(self, draw: DrawFn) -> None:
        self._draw = draw

    def choice(self, *values: Value) -> Value:
        chosen: Value = self._draw(choices(*values))
        return chosen

    def integer(self, low: int, high: int) -> int:
        return self._draw(_numbers(low, high))


@st.composite
def documents(draw: DrawFn, /, **given: Any) -> Document:
    """Draw a scene of a few bodies that meet; see `meeting` for what may be given."""
    return meeting(_Draw(draw), **given)


@st.composite
def smooth_documents(draw: DrawFn, *, steps: int, integrators: tuple[str, ...]) -> Document:
    """Draw softened bodies that pass through each other."""
    return smooth(_Draw(draw), steps=steps, integrators=integrators)


@st.composite
def impact_documents(draw: DrawFn) -> Document:
    """Draw pairs far from each other, each of which collides once."""
    return impacts(_Draw(draw))
