"""The answer of a command says the same on the terminal and in Markdown, and its document is JSON."""

from __future__ import annotations

import json
import math
from operator import itemgetter

import pytest
from markdown_it import MarkdownIt

from carom.scene.units.dimension import LENGTH
from carom.scene.units.system import UnitSystem
from carom.terminal.answers import CommandAnswer, Part, ShownColumn, ShownFacts, ShownTable, Strong, markdown

COLUMNS = [
    ShownColumn("who", itemgetter(0), left=True),
    ShownColumn("d", itemgetter(1), LENGTH, ".3g"),
    ShownColumn("it is | was", itemgetter(2)),
]
ROWS = [("a*b", 1.5, Strong("far")), ("", None, 2), ("c", "near", None)]
PARTS: list[Part] = [
    Strong("Why?"),
    "Since [it] is so.",
    ShownFacts([("A", ["first", "second"]), ("none", ()), ("B", "third")]),
    ShownTable(COLUMNS, ROWS, UnitSystem.of_text("km, s, kg"), keys=1),
]


def test_an_answer_is_lines_facts_and_tables_or_json(capsys: pytest.CaptureFixture[str]) -> None:
    CommandAnswer({"a": [math.nan, 1]}, PARTS).say(True)
    assert json.loads(capsys.readouterr().out) == {"a": [None, 1]}
    CommandAnswer({}, PARTS).say(False)
    lines = [line.rstrip() for line in capsys.readouterr().out.splitlines()]
    assert lines[:5] == ["Why?", "Since [it] is so.", "A  first", "   second", "B  third"]
    assert [line.split() for line in lines[6:] if line] == [
        ["who", "d", "(km)", "it", "is", "|", "was"],
        [lines[7].strip()],
        ["a*b", "1.5", "far"],
        ["2"],
        ["c", "near"],
    ]


def test_markdown_has_the_same_words_and_every_cell_stands_for_itself() -> None:
    tokens = MarkdownIt("commonmark").enable("table").parse(markdown(PARTS))
    said = ["".join(part.content for part in token.children or ()) for token in tokens if token.type == "inline"]
    cells = ["who", "d (km)", "it is | was", "a*b", "1.5", "far", "", "", "2", "c", "near", ""]
    assert said == ["Why?", "Since [it] is so.", "A: first", "second", "B: third", *cells]
    assert [token.tag for token in tokens if token.type == "heading_open"] == ["h2"]
