"""The page and the JSON schema of scenes are those of the schema, and bundled scenes keep to them."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from pydantic import BaseModel
from pydantic.fields import FieldInfo

from carom.scene.conversion import parts_of
from carom.scene.format_page import FILE, MARK, page, schema_text, without_schema_line
from carom.scene.load import Scene
from carom.scene.scene_file import bundled_scenes, extreme_scenes
from carom.scene.schema.body import Columns
from carom.scene.units.dimension import DIMENSIONS, OF_UNIT, Dimension

ROOT = Path(__file__).parents[2]
SCENES = bundled_scenes() | extreme_scenes()
VALIDATOR = jsonschema.Draft202012Validator(json.loads(schema_text()))


def test_the_page_of_the_format_is_up_to_date() -> None:
    written = (ROOT / "docs" / "scene-format.md").read_text(encoding="utf-8")
    assert written == page(), "python -m carom.scene.format_page > docs/scene-format.md"


@pytest.mark.parametrize("row", ['| `warned` | list of `"energy-rise"`', "| `materials` | list of texts |"])
def test_the_page_says_where_a_list_stands(row: str) -> None:
    assert row in page()


def test_the_schema_for_editors_is_up_to_date() -> None:
    written = (ROOT / "configs" / FILE).read_text(encoding="utf-8")
    assert written == schema_text(), f"carom scenes --schema > configs/{FILE}"


@pytest.mark.parametrize("path", SCENES.values(), ids=SCENES.keys())
def test_a_bundled_scene_names_its_schema_and_keeps_to_it(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    mark, named = text.partition("\n")[0].split()
    # an installation has a copy of its own
    assert mark == MARK and (path.parent / named).read_bytes() == (ROOT / "configs" / FILE).read_bytes()
    assert not list(VALIDATOR.iter_errors(tomllib.loads(text)))


@pytest.mark.parametrize(
    "text",
    [
        '[[body]]\nradius = "3 km"\nposition = ["1 au", 0, 0]',
        '[[group]]\nradius = "3 km"',
        "[[group]]\nradius = 3",
        '[[group]]\nradius = { min = "1 m", max = 3 }',
        'units = "au, day, solar mass"',
        '[units]\nlength = "au"',
        '[time]\ntarget_dx = "auto"\nmax_dt = "1 h"',
    ],
)
def test_the_schema_for_editors_accepts_quantities(text: str) -> None:
    assert not list(VALIDATOR.iter_errors(tomllib.loads(text)))


@pytest.mark.parametrize(
    "text",
    [
        '[[body]]\nradius = "3"',
        "[[body]]\nradius = -3",
        "[[body]]\nradios = 3",
        '[time]\ntarget_dx = "autod"',
        '[contact]\nrestitution = "0.5 m"',
        '[units]\nlenght = "au"',
    ],
)
def test_the_schema_for_editors_refuses_mistakes(text: str) -> None:
    assert list(VALIDATOR.iter_errors(tomllib.loads(text)))


def test_a_copied_scene_names_no_schema_that_is_not_beside_it() -> None:
    text = SCENES["two-spheres"].read_text(encoding="utf-8")
    assert text.startswith(MARK) and without_schema_line(text) == text.partition("\n")[2]
    assert without_schema_line("# no schema\n") == "# no schema\n"


def fields(model: type[BaseModel], above: str = "") -> Iterator[tuple[str, FieldInfo]]:
    for key, info in model.model_fields.items():
        yield f"{above}{key}", info
        for part in parts_of(info.annotation):
            if isinstance(part, type) and issubclass(part, BaseModel) and part is not Columns:  # names of columns
                yield from fields(part, f"{above}{key}.")


FIELDS: dict[str, FieldInfo] = dict(fields(Scene))


@pytest.mark.parametrize("key", FIELDS)
def test_the_description_of_a_quantity_begins_with_the_unit_of_its_dimension(key: str) -> None:
    info = FIELDS[key]
    parts: list[Any] = [*info.metadata, *parts_of(info.annotation)]
    found = [part for part in parts if isinstance(part, Dimension)]
    written = (info.description or "").replace(";", ",").partition(",")[0]
    if key == "record.every":  # begins with its words
        assert found == [OF_UNIT["s"]] and "seconds of simulated time" in str(info.description)
    elif found:
        assert [written] == [dimension.unit for dimension in found]
    else:
        assert written not in {dimension.unit for dimension in DIMENSIONS}


def test_the_schema_says_what_each_key_is() -> None:
    described = json.loads(schema_text())["$defs"]["Time"]["properties"]
    assert described["duration"]["description"] == "s, simulated time; more than 0"
    assert described["duration"]["anyOf"][1]["examples"] == ["12 h"]
