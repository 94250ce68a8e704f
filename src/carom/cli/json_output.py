"""Documents for scripts: every `--json` prints one, and nothing else, to standard output."""

from __future__ import annotations

from typing import Any

from carom.cli.text import say
from carom.runs.json_numbers import finite


def say_json(document: Any) -> None:
    """Print a JSON document; NaN and infinity, which JSON does not have, become null."""
    import json

    say(json.dumps(finite(document), indent=2, ensure_ascii=False, allow_nan=False))
