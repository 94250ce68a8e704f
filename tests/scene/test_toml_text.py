from __future__ import annotations

import tomllib
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from carom.lab.shrink.shrunk_file import commented
from carom.scene.scene_file import toml_text

text = st.text(st.characters(exclude_categories=["Cs"]), max_size=10)
scalar = st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | text
value = st.recursive(scalar, lambda inner: st.lists(inner, max_size=3) | st.dictionaries(text, inner, max_size=3))


@given(st.dictionaries(text, value, max_size=5))
def test_a_document_reads_back_as_it_was_written(data: dict[str, Any]) -> None:
    assert tomllib.loads(toml_text(data)) == data


def test_numbers_of_numpy_and_tuples_are_written_as_numbers_and_lists() -> None:
    assert toml_text({"body": [{"position": (np.float64(0.1), 2, 3.0)}]}) == "\n[[body]]\nposition = [0.1, 2, 3.0]\n"


def test_a_value_of_a_type_that_scenes_lack_is_refused() -> None:
    with pytest.raises(TypeError, match="values of type NoneType"):
        toml_text({"time": {"duration": None}})


def test_no_text_steers_a_terminal_that_prints_the_file() -> None:
    texts: dict[str, Any] = {
        "body": [],
        "title": "a\x9b2J\x7f\u202egnp\u2028\u061c\x1b[2J",
        "description": "5 × 10³ kg",
    }
    for written in (toml_text(texts), commented(texts, ["Failure: \x9b2J \u202e\nrm x"])):
        assert tomllib.loads(written) == texts
        assert not set("\x9b\x7f\u202e\u2028\u061c\x1b") & set(written) and "5 × 10³" in written
        assert not any(line.startswith("rm") for line in written.splitlines())
