"""The dialect of a text table: separators, decimal commas, comments, and the lines with names and units of columns."""

from __future__ import annotations

import csv
import io
import itertools
import mmap
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from carom.errors import SceneError
from carom.scene.data import MOST_COLUMNS, number_in, refuse_many_columns
from carom.scene.data.facts import Facts, printable
from carom.scene.data.mapping import usual_names
from carom.scene.wording import counted

HEAD = 1_000_000  # bytes in which a format is recognised; a longer line is refused
_SAMPLE = 50  # largest number of lines of these bytes that are examined
_LARGEST = 500_000_000  # bytes of the largest file that is rewritten in memory
_COMMENTS = ("#", "%", "!", "//")
_SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars", ",": "commas", " ": "blanks"}
_USUAL = {".csv": ",", ".tsv": "\t"}  # separators by suffix, if none divides all lines alike
_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eEdD][+-]?\d+)?")  # a number with a decimal comma
_TITLE = re.compile(r"(?:format|columns?)\s*:\s*", re.IGNORECASE)  # words before the names in a comment
_YADE = re.compile(r"#\s*format\s+(\S+)")  # names of columns in YADE's text export, such as x_y_z_r
_UNIT = re.compile(r"\s+(?=[\[(])")  # blanks before the unit of a name
_NASA = re.compile(r"(?m)^COLUMN (\w+):.*\[([^\[\]]+)\]")  # "COLUMN pl_bmassj: Planet Mass [Jupiter mass]"
_ECSV_NAME = re.compile(r"\bname:\s*('[^']*'|\"[^\"]*\"|[^,}\n]+)")
_ECSV_UNIT = re.compile(r"\bunit:\s*('[^']*'|\"[^\"]*\"|[^,}\n]+)")
_ECSV_EPOCH = re.compile(r"\bepoch:\s*['\"]?J2000(?:\.0)?\b")
_J2000 = 2_451_545.0  # Julian date of the epoch J2000


@dataclass
class TextDialect:
    """The dialect of a text file."""

    names: list[str]  # names of the columns; empty if no line has them
    columns: int  # number of columns
    separator: str  # character between values
    skipped: int  # lines before the first row, in a file that pyarrow reads unchanged
    rows: bytes | None = None  # the rows as plain CSV, if the file must be rewritten
    note: str = ""  # note on the recognised dialect; empty for plain tables


def dialect_of(path: Path, called: str) -> TextDialect:
    """Recognise the dialect of a text file; SceneError names the first line that is not a row."""
    with path.open("rb") as file:
        head = file.read(HEAD)
    if not head.strip():
        raise SceneError(f"{called}: not a table of values: it is empty")
    encoding = "utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    if max(map(len, head.split(b"\n", MOST_COLUMNS))) >= HEAD:
        raise SceneError(f"{called}: not a table of values: a line has more than {HEAD} characters")
    text = head[: head.rfind(b"\n") + 1 or None].decode(encoding, "replace")
    if text.partition("\n")[0].count('"') % 2:  # a quoted name continues in the next line
        separator = _USUAL.get(path.suffix.lower(), ",")
        reader = csv.reader(io.StringIO(text), delimiter=separator)
        names = next(reader)
        return TextDialect(names, len(names), separator, reader.line_num)
    lines = TextLines(io.StringIO(text))
    sample = [text for text, _ in zip(lines, range(_SAMPLE), strict=False)]
    if not sample:
        raise SceneError(f"{called}: not a table of values: it has only comments")
    separator, comma = _separator(sample, _USUAL.get(path.suffix.lower(), " "))
    first = _cells(sample[0], separator)
    has_header = not any(number_in(_with_point(cell) if comma else cell) is not None for cell in first)
    columns = len(first)
    names = first if has_header else _names_in(lines.comments_before, columns, separator)
    if has_header and separator == " ":
        names = _words(sample[0])
        columns = len(names)
    refuse_many_columns(called, columns)
    named = lines.first if has_header else 0
    plain = (
        not head.startswith((b"\xff\xfe", b"\xfe\xff", b"\xef\xbb\xbf"))
        and separator in (",", "\t")
        and not any(line.endswith(separator) for line in sample)
        and not comma
        and not lines.comments
        and lines.first == 1
    )
    if plain:  # comments may also come after the sample
        with path.open("rb") as raw, mmap.mmap(raw.fileno(), 0, access=mmap.ACCESS_READ) as content:
            plain = not any(content.find(b"\n" + sign.encode()) >= 0 for sign in _COMMENTS)
    dialect = TextDialect(names, columns, separator, int(has_header))
    if plain:
        return dialect
    if path.stat().st_size > _LARGEST:
        raise SceneError(
            f"{called}: {path.stat().st_size} bytes are too many for its dialect; write plain CSV or Parquet"
        )
    with path.open(encoding=encoding, errors="surrogateescape", newline="") as file:
        lines = TextLines(file)
        dialect.rows = rewritten(lines, dialect, comma, named, called)
    details = [f"values separated by {_SEPARATORS[separator]}"]
    details += ["decimal commas"] if comma else []
    details += [f"names in line {named}" if named else "names in a comment" if names else "no line with names"]
    details += [f"{counted(lines.comments, 'line')} of comments"] if lines.comments else []
    dialect.note = f"{called}: read with {', '.join(details)}"
    return dialect


class TextLines(Iterator[str]):
    """The lines of a text that are neither empty nor comments."""

    def __init__(self, file: Iterable[str]) -> None:
        self._lines = iter(file)
        self.number = 0  # number of the last line
        self.first = 0  # number of the first line that is not a comment
        self.comments = 0
        self.comments_before = list[str]()

    def __next__(self) -> str:
        while True:
            text = next(self._lines).strip("\r\n ")
            self.number += 1
            if not text or (self.number == 1 and text.startswith("sep=")):  # Excel's hint at the separator
                continue
            if text.startswith(_COMMENTS):
                self.comments += 1
                if not self.first:
                    self.comments_before = [*self.comments_before[-_SAMPLE:], text]
                continue
            self.first = self.first or self.number
            return text


def _separator(sample: Sequence[str], usual: str) -> tuple[str, bool]:
    """Return the separator that divides all lines alike, into the most numbers, and whether decimals follow a comma."""
    body, best = sample[1:] or sample, (0, usual, False)
    for separator in _SEPARATORS:
        rows = [_cells(line, separator, whole=True) for line in body]
        if len(set(map(len, rows))) > 1 or len(rows[0]) < 2:
            continue
        cells = [cell for row in rows for cell in row]
        comma = separator != "," and any(map(_COMMA.fullmatch, cells))
        count = sum(number_in(_with_point(cell) if comma else cell) is not None for cell in cells)
        best = max(best, (count, separator, comma), key=lambda each: each[0])
    return best[1], best[2]


def _cells(line: str, separator: str, whole: bool = False) -> list[str]:
    """Divide a line; a separator at the end is ignored, unless ``whole``."""
    if separator == " ":
        line = line.replace("\t", " ").strip()
    found = next(csv.reader([line], delimiter=separator, skipinitialspace=True), [])
    cells = [cell.strip() for cell in found]
    return cells[:-1] if len(cells) > 1 and not cells[-1] and not whole else cells


def _words(line: str) -> list[str]:
    """Divide names at blanks, each with its unit in brackets."""
    return [word.replace("\0", " ") for word in _cells(_UNIT.sub("\0", line.replace("\t", " ")), " ")]


def _with_point(cell: str) -> str:
    return cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell


def _names_in(comments: Sequence[str], columns: int, separator: str) -> list[str]:
    """Return the column names in the comment with as many names as values; empty if there is none.

    If several comments fit, the comment with the most usual names is chosen, because a sentence may have as many words
    as there are columns; among equally good comments, the last one is chosen.
    """
    best, most = list[str](), -1
    for comment in reversed(comments):
        if yade := _YADE.match(comment):
            names = yade[1].split("_")
        else:
            text = _TITLE.sub("", comment.lstrip("".join(_COMMENTS)).strip())
            used = next((each for each in (separator, ",") if each != " " and each in text), " ")
            names = _words(text) if used == " " else _cells(text, used)
        if len(names) == columns and not any(number_in(name) is not None for name in names):
            usual = usual_names(names)
            best, most = (names, usual) if usual > most else (best, most)
    return best


def rewritten(lines: TextLines, dialect: TextDialect, comma: bool, named: int, called: str) -> bytes:
    """Write the rows as plain CSV."""
    buffer = io.StringIO()
    write = csv.writer(buffer, lineterminator="\n").writerow
    for line in lines:
        if lines.number == named:
            continue
        cells = _cells(line, dialect.separator)
        if len(cells) == dialect.columns - 1 and line.endswith(dialect.separator):  # the last value is empty
            cells.append("")
        if len(cells) != dialect.columns:
            where = f"line {named} names" if named else "the first row has"
            raise SceneError(
                f"{called}: line {lines.number} has {counted(len(cells), 'value')} ({printable(line)}), and {where} "
                f"{dialect.columns}"
            )
        write([_with_point(cell) for cell in cells] if comma else cells)
    return buffer.getvalue().encode("utf-8", "surrogateescape")


def facts_in_comments(path: Path) -> Facts:
    """Return the units in the comments of the NASA Exoplanet Archive, and of astropy's Enhanced CSV, which are YAML."""
    with path.open(encoding="utf-8", errors="replace") as file:
        lines = itertools.takewhile(lambda line: line.startswith("#"), file.read(HEAD).split("\n"))
        header = "\n".join(line[1:].strip() for line in lines)
    if not header.startswith("%ECSV"):
        return Facts(of_columns={name: text.lower() if " " in text else text for name, text in _NASA.findall(header)})
    columns, _, meta = header.partition("\nmeta:")
    starts = [*_ECSV_NAME.finditer(columns)]
    ends = [*(each.start() for each in starts[1:]), len(columns)]
    of_columns = {
        each[1].strip("'\""): found[1].strip("'\" ")
        for each, end in zip(starts, ends, strict=True)
        if (found := _ECSV_UNIT.search(columns, each.end(), end))
    }
    epoch = _ECSV_EPOCH.search(meta)
    return Facts(of_columns=of_columns, epoch=_J2000 if epoch else None)
