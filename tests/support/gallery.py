"""The pictures of docs/gallery.md, made by the commands that the page names below each, and the first of README.md.

    python tests/support/gallery.py [NAME...]

runs these commands in a temporary folder, and writes the pictures with a palette into docs/gallery/. Without names it
makes all of them. The other pictures of the README are from the gallery.
"""

from __future__ import annotations

import re
import shlex
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from PIL import Image

from carom_command import carom

PAGE = Path(__file__).parents[2] / "docs" / "gallery.md"
FOLDER = PAGE.parent / "gallery"

_PICTURE = re.compile(r"!\[[^]]*\]\(gallery/([a-z-]+)\.png\)")
_BLOCK = re.compile(r"```(sh|toml|obj)\n(.*?)```", re.DOTALL)


@dataclass(frozen=True, slots=True)
class Entry:
    """A picture of the page: the commands that make NAME.png, and the scenes and meshes that they read."""

    name: str
    commands: tuple[str, ...]
    files: dict[str, str]


FIRST = Entry(
    "cloud-collapse",
    (
        "carom run cloud-collapse -o collapse.rrd",
        "carom picture collapse.rrd --size 1280x800 -o cloud-collapse.png",
    ),
    {},
)


def entries() -> Iterator[Entry]:
    """Yield the pictures of the page; a file begins with a comment that holds its name."""
    for section in PAGE.read_text(encoding="utf-8").split("\n## ")[1:]:
        picture = _PICTURE.search(section)
        if picture is None:
            continue
        blocks = _BLOCK.findall(section)
        lines = [line for kind, text in blocks if kind == "sh" for line in text.splitlines()]
        files = {text.splitlines()[0].removeprefix("# "): text for kind, text in blocks if kind != "sh"}
        yield Entry(picture[1], tuple(line for line in lines if line.startswith("carom ")), files)


def make(entry: Entry, folder: Path, done: set[str]) -> Path:
    """Run the commands of a picture in a folder, unless they are done already; return the file that they wrote."""
    for name, text in entry.files.items():
        (folder / name).write_text(text, encoding="utf-8")
    for command in entry.commands:
        if command not in done:
            done.add(command)
            ended = carom(*shlex.split(command)[1:], cwd=folder)
            assert ended.returncode == 0, f"{command}: {ended.stderr}"
    return folder / f"{entry.name}.png"


def keep(file: Path, folder: Path = FOLDER) -> None:
    """Write a picture into a folder, by default that of the page."""
    with Image.open(file) as image:
        picture = image.convert("RGB")
    palette = picture.quantize(256, Image.Quantize.FASTOCTREE)
    few = picture.quantize(palette=palette)  # dithered: shades of spheres have no steps
    few.save(folder / file.name, optimize=True)


if __name__ == "__main__":
    wanted, finished = sys.argv[1:], set[str]()
    with tempfile.TemporaryDirectory() as name:
        for each in (FIRST, *entries()):
            if not wanted or each.name in wanted:
                keep(make(each, Path(name), finished), PAGE.parent if each is FIRST else FOLDER)
