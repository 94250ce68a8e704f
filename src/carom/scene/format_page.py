"""The format of a scene, from its schema: a JSON schema for editors, and docs/scene-format.md.

``python -m carom.scene.format_page > docs/scene-format.md`` writes the page.
"""

from __future__ import annotations

import inspect
import json
import sys
import typing
from collections.abc import Iterator
from typing import Any, Literal

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from carom import registry
from carom.scene.contact_laws import law_called
from carom.scene.conversion import members_of_list, parts_of
from carom.scene.load import Scene
from carom.scene.scene_file import value_text
from carom.scene.scene_model import know_installed_parts
from carom.scene.units.dimension import Dimension
from carom.scene.wall_shapes import shape_called

FILE = "scene.schema.json"  # file beside the bundled scenes, whose first lines refer to this file
MARK = "#:schema"  # prefix of the first line of a scene that names its schema


def schema_text() -> str:
    """Return the schema as the text of a file, with the sections of installed packages."""
    know_installed_parts()
    schema = {"$schema": "https://json-schema.org/draft/2020-12/schema", **_brief(Scene.model_json_schema())}
    return json.dumps(schema, indent=2, ensure_ascii=False) + "\n"


def _brief(node: Any) -> Any:
    """Remove titles, which repeat the keys, and empty defaults."""
    if isinstance(node, list):
        return [_brief(inner) for inner in node]
    if not isinstance(node, dict):
        return node
    named = isinstance(node.get("title"), str)
    left_out = {"title"} if named else set()
    left_out |= {"default"} if node.get("default", "") is None else set()
    return {key: _brief(value) for key, value in node.items() if key not in left_out}


def without_schema_line(text: str) -> str:
    """Return the text of a scene without the line that names its schema: that path is valid in one folder only."""
    first, _, rest = text.partition("\n")
    return rest if first.startswith(MARK) else text


INTRODUCTION = """\
# The format of a scene

A scene is a TOML file. This page lists all its sections and keys; it is generated from the schema of scenes.
`carom new` writes a scene with comments on the most important keys. All keys are optional except
keys marked as needed, and a scene needs a body.

If a key has a dimension, a number is in the SI unit, and a text may have another unit, such as `"3 km"`
([units.md](units.md)). Editors that understand JSON schemas, such as editors with Taplo or Even Better TOML, complete
and check scenes. Write the schema with `carom scenes --schema > scene.schema.json`, and begin a scene with the line
`#:schema ./scene.schema.json`.
"""


def page() -> str:
    """Return the page, without the forces, contact laws and shapes of installed packages."""
    parts = [INTRODUCTION, _table(Scene, "At the top"), *_sections(Scene, "")]
    for name in registry.HOUSE["contact_laws"]:
        section = law_called(name).section
        if section is not None:
            where = "Also allowed in a material, a pair and a plane."
            parts.append(_table(section, f"`contact.{name}`", f"{inspect.getdoc(section)} {where}"))
    for name in registry.HOUSE["walls"]:
        section = shape_called(name).section
        parts.append(_table(section, f"`wall.{name}`", inspect.getdoc(section) or ""))
    return "\n".join(parts)


def _sections(model: type[BaseModel], above: str) -> Iterator[str]:
    """Return a section of the page for each section of a model, and for the tables in it."""
    for key, info in _keys(model):
        for inner in _models(info):
            title = f"{above}{key}"
            is_list = typing.get_origin(info.annotation) is tuple
            heading = f"`{title}`" if above else f"`[[{key}]]`" if is_list else f"`[{key}]`"
            yield _table(inner, heading, inspect.getdoc(inner) or "")
            yield from _sections(inner, f"{title}.")


def _keys(model: type[BaseModel]) -> list[tuple[str, FieldInfo]]:
    """Return the keys of a section without the keys of extensions, which models get when a scene is read."""
    later = {*registry.names("contact_laws"), *registry.names("walls")}
    return [(key, info) for key, info in model.model_fields.items() if key not in later]


def _table(model: type[BaseModel], heading: str, text: str = "") -> str:
    sentence = text.partition(": ")[2] or text if heading != "At the top" else ""
    lines = [f"## {heading}", "", *([sentence[0].upper() + sentence[1:], ""] if sentence else [])]
    lines += ["| key | value | unit | default | |", "|---|---|---|---|---|"]
    return "\n".join([*lines, *(_row(key, info) for key, info in _keys(model)), ""])


def _row(key: str, info: FieldInfo) -> str:
    annotations = (*info.metadata, *parts_of(info.annotation))
    dimension = next((part for part in annotations if isinstance(part, Dimension)), None)
    text = info.description or ""
    if dimension:
        text = text.removeprefix(dimension.unit).lstrip(",; ")
    unit = f"{dimension.unit} ({dimension.name})" if dimension else ""
    absent = isinstance(info.default, BaseModel) or info.default in (None, (), {}, "")
    default = "needed" if info.is_required() else "" if absent else f"`{value_text(info.default)}`"
    cells = (f"`{key}`", ", ".join(_values(info)), unit, default, text)
    return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"


def _values(info: FieldInfo) -> Iterator[str]:
    """Yield the kinds of values that a key accepts."""
    known = dict.fromkeys(word for part in parts_of(info.annotation) for word in _words(part))
    if len(members_of_list(info.annotation)) == 3:  # a vector
        known.pop("number", None)
        known["[x, y, z]"] = None
    elif members_of_list(info.annotation) and not _models(info):
        yield f"list of {', '.join(_PLURALS.get(word, word) for word in known)}"
        return
    yield from known


def _words(part: Any) -> Iterator[str]:
    if typing.get_origin(part) is Literal:
        yield from (f"`{value_text(word)}`" for word in typing.get_args(part))
    elif part in _NAMES:
        yield _NAMES[part]
    elif isinstance(part, type) and issubclass(part, BaseModel):
        yield "section"
    elif typing.get_origin(part) is dict:
        yield "table"


_PLURALS = {"number": "numbers", "text": "texts"}
_NAMES = {float: "number", int: "whole number", str: "text", bool: "`true`, `false`"}


def _models(info: FieldInfo) -> list[type[BaseModel]]:
    return [part for part in parts_of(info.annotation) if isinstance(part, type) and issubclass(part, BaseModel)]


if __name__ == "__main__":
    sys.stdout.write(page())
