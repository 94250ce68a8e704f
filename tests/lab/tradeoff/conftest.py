"""The reference of a scene, which takes most of the time of a small study, is made once for all tests."""

from __future__ import annotations

from typing import Any

import pytest

from carom.lab.tradeoff import tradeoff
from carom.lab.tradeoff.reference import Reference, Teller, make_reference
from carom.scene.load import Scene

_made: dict[tuple[str, float, tuple[Any, ...]], tuple[Reference, list[str]]] = {}


@pytest.fixture(autouse=True)
def _one_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    def make(scene: Scene, finest: float, *, tell: Teller, **options: Any) -> Reference:
        asked = scene.toml, finest, tuple(options.values())
        if asked not in _made:
            told = list[str]()
            _made[asked] = make_reference(scene, finest, tell=told.append, **options), told
        reference, told = _made[asked]
        for text in told:
            tell(text)
        return reference

    monkeypatch.setattr(tradeoff, "make_reference", make)
