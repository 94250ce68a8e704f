"""Rows of values separated by blanks, which several formats of particles have; each row is checked."""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence

import numpy as np
import pyarrow as pa
import pyarrow.csv

from carom.errors import SceneError
from carom.scene.data import DataTable, Raw, refuse_many_columns
from carom.scene.data.facts import printable


class TextRows(DataTable):
    """A table of rows separated by blanks; each row is checked."""

    def __init__(self, called: str, names: Sequence[str], lines: Iterable[str], first: int) -> None:
        """Read rows, which must have a value for each name; ``first`` is the line number of the first row."""
        refuse_many_columns(called, len(names))
        self.called, self.names = called, list(names)
        buffer = io.StringIO()
        self.rows = 0
        for number, line in enumerate(lines, start=first):
            values = line.split()
            if len(values) != len(names):
                raise SceneError(
                    f"{called}: line {number} has {len(values)} values ({printable(line.strip())}), but there are "
                    f"{len(names)} columns"
                )
            buffer.write("\t".join(values) + "\n")
            self.rows += 1
        self._content = buffer.getvalue().encode("utf-8", "surrogateescape")

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Read columns by their names."""
        if not self.rows:
            return {name: np.empty(0) for name in names}
        convert = pyarrow.csv.ConvertOptions(
            include_columns=list(dict.fromkeys(names)), column_types=dict.fromkeys(texts, pa.string())
        )
        table = pyarrow.csv.read_csv(
            pa.BufferReader(self._content),
            pyarrow.csv.ReadOptions(column_names=self.names),
            parse_options=pyarrow.csv.ParseOptions(delimiter="\t", quote_char=False),
            convert_options=convert,
        )
        return {name: np.asarray(table[name].to_numpy()) for name in names}
