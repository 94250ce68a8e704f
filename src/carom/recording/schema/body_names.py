"""Names of the bodies as a recording stores them: numbered ones by their prefix."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from carom.errors import DamageError
from carom.scene.wording import JoinedNames, NumberedNames, joined

Stored = Mapping[str, NDArray[Any] | list[str]]

_COUNT, _FIRST = "name_count", "name_first"


def stored_names(names: Sequence[str]) -> dict[str, Any]:
    """Return the components that hold the names.

    Without numbered names there is one, ``name``. Otherwise ``name_count`` has 0 for a whole name, and for a prefix the
    number of bodies that have it; ``name_first`` is the number of the first of them.
    """
    parts = names.parts if isinstance(names, JoinedNames) else (names,)
    if not any(isinstance(part, NumberedNames) for part in parts):
        return {"name": list(names)}
    texts, counts, firsts = list[str](), list[int](), list[int]()
    for part in parts:
        if isinstance(part, NumberedNames):
            texts.append(part.prefix)
            counts.append(len(part))
            firsts.append(part.first)
        else:
            texts += part
            counts += [0] * len(part)
            firsts += [0] * len(part)
    return {"name": texts, _COUNT: np.array(counts, np.int64), _FIRST: np.array(firsts, np.int64)}


def names_of(stored: Stored) -> Sequence[str]:
    """Undo `stored_names`. DamageError if they do not fit together."""
    texts = stored["name"]
    if not isinstance(texts, list):
        raise DamageError("names of its bodies are not texts")
    if _COUNT not in stored:
        return texts
    counts, firsts = np.asarray(stored[_COUNT]), np.asarray(stored.get(_FIRST))
    whole = (len(texts),)
    if any(array.shape != whole or array.dtype != np.int64 or np.any(array < 0) for array in (counts, firsts)):
        raise DamageError("names of its bodies do not have a number each")
    parts, own = list[Sequence[str]](), list[str]()
    for text, count, first in zip(texts, counts.tolist(), firsts.tolist(), strict=True):
        if count == 0:
            own.append(text)
            continue
        parts += [own] if own else []
        parts.append(NumberedNames(text, count, first))
        own = []
    return joined([*parts, *([own] if own else [])])
