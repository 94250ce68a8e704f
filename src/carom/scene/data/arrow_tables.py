"""Tables that pyarrow reads: CSV, Parquet, and Arrow or Feather files.

`text_dialect` recognises the separators, comments and names of a text table.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence, Set
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.csv
import pyarrow.ipc
import pyarrow.parquet as pq

from carom import registry
from carom.arrow_claims import claims, columns, unpacked_bytes
from carom.errors import SceneError
from carom.scene.data import (
    NUMBER,
    DataFormat,
    DataTable,
    Raw,
    refuse_bomb,
    refuse_large,
    refuse_many_columns,
    refuse_many_rows,
)
from carom.scene.data.facts import Facts, printable
from carom.scene.data.text_dialect import HEAD, TextLines, dialect_of, facts_in_comments, rewritten

_STREAM_IN_FILE = 8  # bytes before the stream in an Arrow file
# The first line of an MPCORB without its header: packed epoch, four angles and eccentricity in their columns.
_MPC_LINE = rb"\A\s*^.{20}[IJK]\d\d[1-9A-C][1-9A-V] [ .\d]{9}(?:  [ .\d]{9}){3}  [ 01]\.\d{7} "
# texts that identify a format, whatever the suffix of the file
_SIGNS = {
    re.compile(rb"\$\$SOE"): "horizons",
    re.compile(rb"ITEM: TIMESTEP"): "dump",
    re.compile(rb"Des'n|" + _MPC_LINE, re.MULTILINE): "mpcorb",
}
_UNIT_KEYS = (b"unit", b"units")  # keys of units in the metadata of a field
_PARQUET_END = 8  # bytes at the end of a file: the length of the footer, and a mark
_FOOTER_HEAD = 32  # number of a footer's first bytes, which contain the number of its elements
# head of a footer whose list has 15 or more elements
_FOOTER = re.compile(rb"\x15[\x80-\xff]*[\x00-\x7f]\x19\xfc([\x80-\xff]*[\x00-\x7f])", re.S)
_BLOCK = 1 << 20  # bytes of a file that are read at a time
_ELEMENTS = 4  # largest number of elements of a schema for each column; a list has three
_Read = Callable[[list[str], Sequence[str]], pa.Table]


def open_csv(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a text file with one row of values per body, in any usual dialect."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    for sign, name in _SIGNS.items():
        if sign.search(head):
            other: DataFormat = registry.load("data_formats", name)
            return other.open(path, called, snapshot)
    refuse_large(called, "the file", path.stat().st_size)
    return _TextTable(path, called)


def open_parquet(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a Parquet file."""
    refuse_many_columns(called, _columns_of_parquet(path), _ELEMENTS)
    stored, schema = path.stat().st_size, pq.read_schema(path, memory_map=True)
    texts = [each.name for each in schema if pa.types.is_string(each.type) or pa.types.is_large_string(each.type)]
    # with dictionaries, a text that many rows repeat is stored once
    file = pq.ParquetFile(path, memory_map=True, read_dictionary=texts)
    refuse_many_rows(called, file.metadata.num_rows, stored)

    def read(wanted: list[str], _: Sequence[str]) -> pa.Table:
        refuse_bomb(called, _claimed(file.metadata, set(wanted)), stored)
        return file.read(columns=wanted)

    return _ArrowTable(called, schema.names, read, stored, schema)


def _columns_of_parquet(path: Path) -> int:
    """Return the number of elements of a schema, read from the footer's first bytes, since pyarrow is slow for many.

    The footer begins with the version and the list of the elements (Thrift's compact protocol). For any other
    beginning, return 0; pyarrow then reports the damage.
    """
    with path.open("rb") as file:
        end = file.seek(0, 2)
        file.seek(max(0, end - _PARQUET_END))
        length = int.from_bytes(file.read(4), "little")
        file.seek(max(0, end - _PARQUET_END - length))
        head = file.read(min(length, _FOOTER_HEAD))
    found = _FOOTER.match(head)
    if found is None:
        return 0
    digits: bytes = found[1]
    return sum((byte & 0x7F) << 7 * place for place, byte in enumerate(digits)) - 1  # the first element is the root


def _claimed(metadata: pq.FileMetaData, wanted: Set[str]) -> int:
    """Return the uncompressed size (bytes) of columns, from the metadata of a Parquet file."""
    total = 0
    for group in range(metadata.num_row_groups):
        for k in range(metadata.num_columns):
            column = metadata.row_group(group).column(k)
            if column.path_in_schema.partition(".")[0] in wanted:
                total += max(column.total_uncompressed_size, NUMBER * column.num_values)
    return total


def open_arrow(path: Path, called: str, snapshot: int) -> DataTable:
    """Open an Arrow file, an Arrow stream or a Feather file."""
    with pa.memory_map(str(path)) as source:
        file = source.read(6) == b"ARROW1"
        # before decompression, refuse batches whose buffers would become far larger than the file
        stored = path.stat().st_size
        source.seek(_STREAM_IN_FILE if file else 0)
        messages, claimed = pyarrow.ipc.MessageReader.open_stream(source), 0
        for message in messages:
            if message.type == "schema":
                refuse_many_columns(called, columns(message.metadata.to_pybytes()))
            if message.body is not None and message.type in ("record batch", "dictionary"):
                header = claims(message.metadata.to_pybytes(), message.type == "dictionary")
                claimed += unpacked_bytes(header, memoryview(message.body))
                refuse_bomb(called, claimed, stored)
        source.seek(_STREAM_IN_FILE if file else 0)  # the footer is not used, since it could refer to other batches
        reader = pyarrow.ipc.open_stream(source)
        batches, rows = list[pa.RecordBatch](), 0
        for batch in reader:
            rows += batch.num_rows
            refuse_many_rows(called, rows, stored)
            batch.validate(full=True)
            batches.append(batch)
        table = pa.Table.from_batches(batches, reader.schema)

    def read(wanted: list[str], _: Sequence[str]) -> pa.Table:
        for name in wanted:
            if not _stores_each_row(table.schema.field(name).type):
                kind = str(table.schema.field(name).type)[:80]
                raise SceneError(f"{called}: column {printable(name)} is of type {kind}; write numbers or text")
        return table.select(wanted)

    return _ArrowTable(called, reader.schema.names, read, stored, reader.schema)


def _stores_each_row(kind: pa.DataType) -> bool:
    """Return whether each value has its own memory; otherwise a few bytes may represent any number of nulls or runs."""
    if pa.types.is_null(kind) or pa.types.is_run_end_encoded(kind):
        return False
    if pa.types.is_dictionary(kind):
        return _stores_each_row(kind.value_type)
    return all(_stores_each_row(kind.field(k).type) for k in range(kind.num_fields))


def _is_list(kind: pa.DataType) -> bool:
    return bool(pa.types.is_list(kind) or pa.types.is_large_list(kind) or pa.types.is_fixed_size_list(kind))


def _unit_of(column: pa.Field) -> str:
    """Return the unit in the metadata of a column; empty without one."""
    metadata = column.metadata or {}
    return next((metadata[key].decode("utf-8", "replace") for key in _UNIT_KEYS if key in metadata), "")


def _lines_in(path: Path) -> int:
    """Return the number of lines of a file, or more if a quoted value has several lines."""
    with path.open("rb") as file:
        counts = [(block.count(b"\n"), block.count(b"\r")) for block in iter(lambda: file.read(_BLOCK), b"")]
    return max(map(sum, zip(*counts, strict=True)), default=0)


class _ArrowTable(DataTable):
    """Columns of an Arrow table."""

    def __init__(
        self, called: str, names: Sequence[str], read: _Read, stored: int, schema: pa.Schema | None = None
    ) -> None:
        self.called, self._stored = called, stored  # name in messages, and size of the file in bytes
        self.names = list(names)
        self._read = read
        if schema is not None:
            fields = [schema.field(k) for k in range(len(schema))]
            self.vectors = [each.name for each in fields if _is_list(each.type)]
            self.facts = Facts(of_columns={each.name: text for each in fields if (text := _unit_of(each))})

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read columns."""
        for name in names:
            if self.names.count(name) > 1:
                raise SceneError(f'{self.called}: two columns are called "{name}"; give each column its own name')
        table = self._read(list(dict.fromkeys(names)), texts)
        return {name: self._array(name, table[name], name in texts) for name in names}

    def _array(self, name: str, column: pa.ChunkedArray, is_text: bool) -> Raw:
        """Convert a column. Missing numbers become NaN, except in columns of text."""
        kind = column.type
        if pa.types.is_dictionary(kind):
            if pa.types.is_string(kind.value_type) or pa.types.is_large_string(kind.value_type):
                lengths = (pc.max(pc.binary_length(chunk.dictionary)).as_py() or 0 for chunk in column.chunks)
                refuse_bomb(self.called, len(column) * max(lengths, default=0), self._stored)
            column, kind = column.cast(kind.value_type), kind.value_type
        if _is_list(kind):
            lengths = pc.fill_null(pc.list_value_length(column), 0).to_numpy()
            if np.any(lengths != 3):
                row = int(np.argmax(lengths != 3))
                raise SceneError(
                    f"{self.called}: column {name}, row {row}: {lengths[row]} numbers instead of [x, y, z]"
                )
            return np.asarray(pc.list_flatten(column).to_numpy()).reshape(-1, 3)
        if is_text and pa.types.is_integer(kind):
            column, kind = column.cast(pa.string()), pa.string()
        if pa.types.is_decimal(kind) or (column.null_count and pa.types.is_integer(kind)):
            column = column.cast(pa.float64(), safe=False)
        return np.asarray(column.to_numpy())


class _TextTable(_ArrowTable):
    """Columns of a text file."""

    def __init__(self, path: Path, called: str) -> None:
        self._path = path
        self._dialect = dialect_of(path, called)
        super().__init__(called, self._dialect.names, self._read_text, path.stat().st_size)
        self.facts = facts_in_comments(path)
        self.notes = (self._dialect.note,) if self._dialect.note else ()
        self.unnamed = 0 if self.names else self._dialect.columns

    def rename(self, names: Sequence[str]) -> None:
        """Name all columns."""
        if len(names) != self._dialect.columns:
            raise SceneError(
                f"{self.called}: it has {self._dialect.columns} columns, but the key columns has {len(names)} names"
            )
        self.names, self.unnamed = list(names), 0

    def _read_text(self, wanted: list[str], texts: Sequence[str]) -> pa.Table:
        rows = self._dialect.rows
        refuse_many_rows(
            self.called,
            _lines_in(self._path) - self._dialect.skipped if rows is None else rows.count(b"\n"),
            self._stored,
        )
        source = self._path if rows is None else pa.BufferReader(rows)
        skipped, separator = (self._dialect.skipped, self._dialect.separator) if rows is None else (0, ",")
        options = pyarrow.csv.ReadOptions(column_names=self.names, skip_rows=skipped)
        parse = pyarrow.csv.ParseOptions(delimiter=separator)
        # columns are read as bytes; otherwise 007 would become a number, and null a missing value
        kinds = dict.fromkeys(texts, pa.binary())
        convert = pyarrow.csv.ConvertOptions(include_columns=wanted, column_types=kinds)
        try:
            table = pyarrow.csv.read_csv(source, options, parse_options=parse, convert_options=convert)
        except pa.ArrowInvalid:
            if rows is None:  # this reports the first line with another number of values
                with self._path.open(encoding="utf-8-sig", errors="surrogateescape", newline="") as file:
                    rewritten(TextLines(file), self._dialect, False, skipped, self.called)
            raise
        for text in texts:
            # 5.0 in a column of whole numbers means 5, since pandas writes floats if a value is missing
            column = table[text]
            if pc.all(pc.match_substring_regex(column, r"^((0|[1-9][0-9]*)\.0)?$")).as_py():
                column = pc.replace_substring_regex(column, r"\.0$", "")
            table = table.set_column(table.column_names.index(text), text, column)
        return table


CSV = DataFormat("a table of values", open_csv)
PARQUET = DataFormat("a Parquet file", open_parquet)
ARROW = DataFormat("an Arrow file", open_arrow)
