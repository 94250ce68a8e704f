"""A name has one place: "go to symbol" and "open file" have one answer."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import carom

HOUSE = Path(carom.__file__).parent


def test_no_two_modules_have_one_name_but_a_command_and_its_tool() -> None:
    places = defaultdict(list)
    for file in HOUSE.rglob("*.py"):
        if file.name not in ("__init__.py", "__main__.py"):
            places[file.name].append(str(file.parent.relative_to(HOUSE)))
    twice = {name: found for name, found in places.items() if len(found) > 1}
    commands = {name for name, found in twice.items() if len(found) == 2 and "cli" in found}
    assert not {name: found for name, found in twice.items() if name not in commands}


def test_no_two_public_classes_have_one_name() -> None:
    places = defaultdict(list)
    for file in HOUSE.rglob("*.py"):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(file.relative_to(HOUSE)))
    assert not {name: found for name, found in places.items() if len(found) > 1}
