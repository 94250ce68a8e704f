"""The index page of a published folder."""

from __future__ import annotations

import html
import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

INDEX, STYLE = "index.html", "index.css"


@dataclass(frozen=True, slots=True)
class Figure:
    """A moment on the page."""

    lines: Sequence[str]  # its description
    link: str  # to the viewer, paused at the moment
    picture: str  # name of its file; empty without one


def write_index(
    folder: Path, title: str, name: str, rows: Sequence[tuple[str, str]], figures: Sequence[Figure]
) -> None:
    """Write the page and its style into a folder that has the recording.

    Parameters
    ----------
    folder
        The folder of the recording and the viewer.
    title
        Of the scene.
    name
        File name of the recording when it is downloaded.
    rows
        Names and texts of a table.
    figures
        The moments.
    """
    page = resources.files(__package__) / "page"
    size = (folder / "recording.rrd").stat().st_size
    text = Template((page / INDEX).read_text(encoding="utf-8")).substitute(
        title=html.escape(title),
        file=html.escape(name),
        quoted=html.escape(shlex.quote(name)),
        size=f"{size / 1e6:.3g} MB",
        rows="\n".join(f"      <tr><th>{html.escape(row)}</th><td>{html.escape(text)}</td></tr>" for row, text in rows),
        moments="\n".join(map(_figure, figures)),
    )
    (folder / INDEX).write_text(text, encoding="utf-8")
    (folder / STYLE).write_bytes((page / STYLE).read_bytes())


def _figure(figure: Figure) -> str:
    link = html.escape(figure.link)
    lines = "".join(f"<p>{html.escape(line)}</p>" for line in figure.lines)
    alt = html.escape(figure.lines[0])
    picture = f'<img src="{html.escape(figure.picture)}" alt="{alt}" width="1600" height="1000" />'
    shown = picture if figure.picture else "Open this moment in the viewer"
    return f'      <figure><a href="{link}">{shown}</a><figcaption>{lines}</figcaption></figure>'
