"""The table of a sweep."""

from __future__ import annotations

from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from carom.errors import ExperimentError
from carom.lab.sweep import sweep_table as figure
from carom.lab.sweep.manifest import Folder, SweepRun
from carom.lab.sweep.sweep_table import chosen, rows_of, write

RUNS = [
    SweepRun("a", {"x": 1.0, "v": [0, 1]}, 1, "done", "completed", results={"e": 3.0, "met": True}),
    SweepRun("b", {"x": 2.0, "v": [0, 2]}, 1, "failed", "refused"),
    SweepRun("c", {"x": 2.0, "v": "none"}, 2, "done", "completed", results={"e": 1.0, "met": False}),
]
ROWS = rows_of(RUNS)


def names(*conditions: str, sort: str | None = None) -> str:
    return "".join(row["name"] for row in chosen(ROWS, conditions, sort))


def test_rows_are_filtered_by_comparisons_that_all_hold() -> None:
    assert names() == "abc"
    assert names("x=2") == "bc" and names("x!=2") == "a" and names("x>=2", "seed<2") == "b"
    assert names("outcome=completed") == "ac" and names("e>0") == "ac" and names("met=true") == "a"
    assert names("v=[0, 1]") == "a"


def test_rows_are_sorted_and_those_without_a_value_come_last() -> None:
    assert names(sort="e") == "cab" and names(sort="-e") == "acb" and names(sort="-name") == "cba"
    with pytest.raises(ExperimentError, match="no such column"):
        names(sort="nothing")


def test_quantities_with_units_are_compared_and_sorted_by_their_sizes() -> None:
    sizes = {"a": "100 cm", "b": "50 cm", "c": "0.7 m", "d": None}
    rows = rows_of([SweepRun(name, {"r": size, "kind": "wet"}, 1, "done", "") for name, size in sizes.items()])

    def found(*conditions: str, sort: str | None = None) -> str:
        return "".join(row["name"] for row in chosen(rows, conditions, sort))

    assert found(sort="r") == "bcad" and found(sort="-r") == "acbd"
    assert found("r>60 cm") == "ac" and found("r=1 m") == "a" and found("r!=500 mm") == "ac"
    for condition in ("r>0.6", "r>1 s", "kind>dry"):
        with pytest.raises(ExperimentError, match=r"column (r has units, such as|kind is text)"):
            found(condition)


def test_a_word_among_numbers_or_quantities_meets_no_comparison_but_unequal() -> None:
    sizes = {"a": "auto", "b": "10 ms", "c": 0.02, "d": "50 ms"}
    rows = rows_of([SweepRun(name, {"dt": size}, 1, "done", "") for name, size in sizes.items()])

    def found(condition: str) -> str:
        return "".join(row["name"] for row in chosen(rows, [condition], None))

    assert (found("dt<20 ms"), found("dt<0.1"), found("dt=auto")) == ("b", "c", "a")
    assert (found("dt!=auto"), found("dt!=0.02")) == ("bcd", "abd")


@pytest.mark.needs("matplotlib")
def test_a_figure_has_the_unit_of_a_column_of_quantities_on_its_axis() -> None:
    rows = rows_of([SweepRun("a", {"r": "50 cm"}, 1, "done", ""), SweepRun("b", {"r": "1 m"}, 1, "done", "")])
    unit = figure._unit(rows, "r")
    assert figure._labelled("r", unit) == "r (cm)"
    assert [figure._number(row, "r", unit) for row in rows] == [50.0, 100.0]


def test_columns_have_one_type(tmp_path: Path) -> None:
    write(Folder(tmp_path), RUNS)
    table = pq.read_table(tmp_path / "table.parquet")
    assert table.schema.field("e").type == pa.float64() and table["e"].to_pylist() == [3.0, None, 1.0]
    assert table["v"].to_pylist() == ["[0, 1]", "[0, 2]", "none"]
    assert table.schema.field("met").type == pa.bool_() and table.schema.field("seed").type == pa.int64()
