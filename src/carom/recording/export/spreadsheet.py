"""Tables as CSV that a spreadsheet shows and does not compute."""

from __future__ import annotations

import re

import pyarrow as pa
from pyarrow import compute

from carom.recording.read.state_columns import units_of

_FORMULAS = r"^([=+\-@\t\r])"  # first characters of what a spreadsheet computes


def in_csv(table: pa.Table) -> pa.Table:
    """Return a table for CSV: harmless, with the unit of each field in its name, such as "x [m]"."""
    units = units_of(table)
    named = [f"{name} [{units[name]}]" if name in units else name for name in table.column_names]
    return harmless(table.rename_columns(named))


def harmless(table: pa.Table) -> pa.Table:
    """Return a table for CSV whose names and texts are no formulas: a spreadsheet shows a text after an apostrophe."""
    columns = [
        compute.replace_substring_regex(column, _FORMULAS, r"'\1") if pa.types.is_string(column.type) else column
        for column in table.columns
    ]
    return pa.table(columns, names=[re.sub(_FORMULAS, r"'\1", name) for name in table.column_names])
