"""[sweep]: what `carom sweep` varies."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import BeforeValidator, Field

from carom.scene.schema.quantity import Count, Section
from carom.scene.variation import MOST_RUNS, Values, alike, flattened, values_of


def _values_by_key(given: Any) -> Any:
    """Read the varied values: lists as they are, text in the syntax of `--vary`."""
    if not isinstance(given, dict):
        return given
    found: dict[str, Values] = {}
    count = 0
    for key, value in flattened(given).items():
        found[key] = (
            values_of(value) if isinstance(value, str) else alike(value if isinstance(value, list) else [value])
        )
        count += len(found[key])
        if count > MOST_RUNS:
            raise ValueError(f"more than {MOST_RUNS} values; give fewer")
    return found


class Sweep(Section):
    """[sweep]: what `carom sweep` varies; `carom run` ignores it."""

    vary: Annotated[dict[str, Values], BeforeValidator(_values_by_key)] = Field(
        {}, description='values by key: a list, or text such as "0.1:0.9:5" or "1e-3:1:4log"'
    )
    seeds: Count | None = Field(
        None, description="runs of each combination, with seeds counted up from the scene's own; 1 or more"
    )
    zip: Annotated[bool, Field(strict=True)] = Field(
        False,
        description="true: combine the first values of all keys, then the second, …; false: combine each with each",
    )
