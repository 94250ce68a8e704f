"""The answer of a command: lines, facts and tables, printed on the terminal, or written as JSON or Markdown.

The JSON document is a promise to programs, with numbers in the units of the recording. Lines, facts and tables are for
people, with numbers in the units of the scene; a command lists them once, for the terminal and for the viewer.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from itertools import pairwise
from operator import itemgetter
from typing import TYPE_CHECKING, Any, NamedTuple

from carom.scene.units.dimension import Dimension
from carom.scene.units.system import SI, UnitSystem
from carom.scene.wording import literal
from carom.terminal.printing import say, say_json

if TYPE_CHECKING:
    from rich.table import Table

# name of the colouring if `colour_by` is "material"; bodies usually have the colour of their group
COLOUR = "colour by material"


class Strong(str):
    """A line that is a heading, or a cell that stands out."""

    __slots__ = ()


class ShownFacts(NamedTuple):
    """Names, each with the lines of text beside it; a name without lines is left out."""

    rows: Iterable[tuple[str, str | Iterable[str]]]
    whole: bool = False  # whether to print numbers indented and, if necessary, in lines wider than the terminal

    def lines(self) -> Iterator[tuple[str, str]]:
        """Yield each line with its name, which is empty in all lines but the first of a name."""
        for name, texts in self.rows:
            for k, text in enumerate([texts] if isinstance(texts, str) else texts):
                yield "" if k else name, text


class ShownColumn(NamedTuple):
    """A column of a table."""

    label: str
    value: Callable[[Any], Any]  # value of a cell from its row; None leaves the cell empty
    dimension: Dimension | None = None  # dimension of numbers; without one, values are written as they are
    form: str = ".4g"  # format of numbers
    left: bool = False  # whether cells are aligned to the left

    def cell(self, row: Any, units: UnitSystem) -> str:
        """Write the value of a row: a text, or a number in units of the simulation."""
        value = self.value(row)
        if value is None or isinstance(value, str):
            return value or ""
        return str(value) if self.dimension is None else f"{units.shown(value, self.dimension):{self.form}}"


class ShownTable(NamedTuple):
    """Rows below headings. A row whose first cell is empty belongs to the row above it."""

    columns: Sequence[ShownColumn]
    rows: Iterable[Any]
    units: UnitSystem = SI
    indent: bool = False  # whether rows are indented by one character
    keys: int = 0  # number of leading columns that identify a row

    def headings(self) -> list[str]:
        """Return the headings of the columns, with units."""
        labels = ((column.label, column.dimension) for column in self.columns)
        return [label if dimension is None else self.units.labelled(label, dimension) for label, dimension in labels]

    def cells(self) -> list[list[str]]:
        """Return the cells of all rows."""
        return [[column.cell(row, self.units) for column in self.columns] for row in self.rows]


Part = str | ShownFacts | ShownTable


class CommandAnswer(NamedTuple):
    """The answer of a command: a document for programs, and parts for people."""

    document: Any
    parts: Iterable[Part]

    def say(self, as_json: bool) -> None:
        """Print the document as JSON, or the parts."""
        if as_json:
            say_json(self.document)
        else:
            print_parts(self.parts)


def print_parts(parts: Iterable[Part]) -> None:
    """Print lines, facts and tables on the terminal.

    A table is wider than the terminal if necessary. If the table has key columns, however, columns that do not fit go
    into further tables below it, which repeat the key columns.
    """
    for part in parts:
        if isinstance(part, str) and not isinstance(part, Strong):
            say(part)
            continue
        from rich.table import Table

        from carom.terminal.console import WIDEST, Terminal, print_whole

        console = Terminal(soft_wrap=True)
        if isinstance(part, str):
            console.print(part, style="bold")
        elif isinstance(part, ShownFacts):
            grid = Table.grid(padding=(0, 2))
            for name, text in part.lines():
                grid.add_row(f"  {name}" if part.whole else name, text)
            (print_whole if part.whole else console.print)(grid)
        elif not (part.keys and console.is_terminal):
            print_whole(_drawn(part, part.cells(), range(len(part.columns))))
        else:
            widest, cells, keys = console.options.update(width=WIDEST), part.cells(), range(part.keys)
            tables = [list[int]()]
            for k in range(part.keys, len(part.columns)):
                wider = _drawn(part, cells, [*keys, *tables[-1], k])
                if tables[-1] and console.measure(wider, options=widest).maximum > console.width:
                    tables.append([])
                tables[-1].append(k)
            for own in tables:
                known = [row for row in cells if own is tables[0] or any(row[k] for k in own)]
                Terminal().print(_drawn(part, known, [*keys, *own]))


def _drawn(table: ShownTable, cells: list[list[str]], columns: Sequence[int]) -> Table:
    """Return some columns of a table as Rich draws them."""
    from rich import box
    from rich.table import Table
    from rich.text import Text

    shown, headings = Table(box=box.SIMPLE_HEAD if table.keys else None, pad_edge=table.indent), table.headings()
    for k in columns:
        left = table.columns[k].left
        shown.add_column(headings[k], justify="left" if left else "right", no_wrap=not left)
    grouped = not all(row[0] for row in cells)
    for row, after in pairwise([*cells, [""]]):
        texts = (Text(row[k], "bold" if isinstance(row[k], Strong) else "") for k in columns)
        shown.add_row(*texts, end_section=grouped and bool(after[0]))
    return shown


def markdown(parts: Iterable[Part]) -> str:
    """Write lines, facts and tables as Markdown, for the viewer."""
    lines: list[str] = []
    for part in parts:
        if isinstance(part, ShownFacts):
            lines += ["", *(f"- {literal(f'{name}: {text}' if name else text)}" for name, text in part.lines()), ""]
        elif isinstance(part, ShownTable):
            rows = [part.headings(), *part.cells()]
            drawn = [f"| {' | '.join(_in_markdown(cell) for cell in row)} |" for row in rows]
            ruler = "|".join("---" if column.left else "--:" for column in part.columns)
            lines += ["", drawn[0], f"|{ruler}|", *drawn[1:], ""]
        else:
            lines += [f"## {literal(part)}", ""] if isinstance(part, Strong) else [f"{literal(part)}  "]
    return "\n".join(lines)


def _in_markdown(cell: str) -> str:
    return f"**{literal(cell)}**" if isinstance(cell, Strong) and cell else literal(cell)


def materials_table(materials: Sequence[dict[str, Any]]) -> ShownTable:
    """Show the coefficients of each kind of contact, given `ShownMaterials.described`."""
    rows: list[list[str]] = []
    listed: set[str] = set()
    for material in materials:
        first = [material["name"], str(material["bodies"]), material["colour"]]
        for other, coefficients in material["contacts"].items():
            if other not in listed:  # otherwise the pair is already listed with the other material
                rows.append([*first, other, *(f"{value:.4g}" for value in coefficients.values())])
                first = ["", "", ""]
        listed.add(material["name"])
    labels = ("material", "bodies", COLOUR, "on", "e", "μs", "μk")
    lefts = ("material", COLOUR, "on")
    return ShownTable([ShownColumn(each, itemgetter(k), left=each in lefts) for k, each in enumerate(labels)], rows)
