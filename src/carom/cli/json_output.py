"""Documents for scripts: every `--json` prints one, and nothing else, to standard output."""

from __future__ import annotations

import math
from typing import Any

from carom.cli.text import say


def say_json(document: Any) -> None:
    """Print a JSON document; NaN and infinity, which JSON does not have, become null."""
    import json

    say(json.dumps(finite(document), indent=2, ensure_ascii=False, allow_nan=False))


def finite(value: Any) -> Any:
    """Return a document with None in place of numbers that are not finite."""
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: finite(inner) for key, inner in value.items()}
    return [finite(inner) for inner in value] if isinstance(value, (list, tuple)) else value
