"""The JSON schema of a scene, by which editors complete and check TOML files."""

from __future__ import annotations

import json
from typing import Any

from carom.scene.schema import Scene

FILE = "scene.schema.json"  # beside the bundled scenes, which name it in their first line
MARK = "#:schema"  # what the first line of a scene begins with if it names its schema


def schema_text() -> str:
    """Return the schema as the text of a file."""
    return json.dumps(schema(), indent=2, ensure_ascii=False) + "\n"


def schema() -> dict[str, Any]:
    """Return the schema; it accepts plain numbers and texts with units wherever a quantity may stand."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **_brief(Scene.model_json_schema())}


def _brief(node: Any) -> Any:
    """Leave out titles, which repeat the keys, and defaults that are not there."""
    if isinstance(node, list):
        return [_brief(inner) for inner in node]
    if not isinstance(node, dict):
        return node
    named = isinstance(node.get("title"), str)
    left_out = {"title"} if named else set()
    left_out |= {"default"} if node.get("default", "") is None else set()
    return {key: _brief(value) for key, value in node.items() if key not in left_out}


def without_schema_line(text: str) -> str:
    """Return the text of a scene without the line that names its schema, whose path is right in one folder only."""
    first, _, rest = text.partition("\n")
    return rest if first.startswith(MARK) else text
