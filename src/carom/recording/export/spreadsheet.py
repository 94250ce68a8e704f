"""Tables as CSV that a spreadsheet shows but does not evaluate."""

from __future__ import annotations

import re

import pyarrow as pa

from carom.recording.read.state_columns import units_of

# Spreadsheets evaluate a text that begins with one of these characters; Asian spreadsheets also write them at full
# width. Spreadsheets drop blanks, marks without a width and control characters at the beginning, and may split a text
# that contains a separator other than a comma.
_FORMULA = '["\\s\x00-\x20\x7f-\xa0\u200b-\u200f\u2028-\u202f\u2060\u3000\ufeff]*[=+@\uff1d\uff0b\uff0d\uff20-]'
_NUMBER = r"\s*[+-][0-9.]+(?:[eE][-+]?[0-9]+)?\s*(?:[\])},;]|$)"  # numbers of a list, such as [1, -2]
_FORMULAS = re.compile(rf"(^|[;,|\t\r\n](?!{_NUMBER}))(?={_FORMULA})")


def in_csv(table: pa.Table) -> pa.Table:
    """Return a table for CSV: harmless, with the unit of each field in its name, such as "x [m]"."""
    units = units_of(table)
    named = [f"{name} [{units[name]}]" if name in units else name for name in table.column_names]
    return harmless(table.rename_columns(named))


def harmless(table: pa.Table) -> pa.Table:
    """Return a table for CSV whose names and texts are not formulas: a spreadsheet shows a text after an apostrophe."""
    return pa.table(list(map(_shown, table.columns)), names=list(map(_text, table.column_names)))


def _shown(column: pa.ChunkedArray) -> pa.ChunkedArray:
    """Return a column of texts that are not formulas; numbers do not change."""
    kind = column.type.value_type if pa.types.is_dictionary(column.type) else column.type
    if not (pa.types.is_string(kind) or pa.types.is_large_string(kind)):
        return column
    encoded = column.dictionary_encode().combine_chunks()  # encodes each text once, however many rows have it
    texts = pa.array([None if text is None else _text(text) for text in encoded.dictionary.to_pylist()], pa.string())
    return pa.chunked_array([texts.take(encoded.indices)])


def _text(text: str) -> str:
    return _FORMULAS.sub(r"\1'", text)
