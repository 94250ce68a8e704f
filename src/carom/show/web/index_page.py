"""Writes the pages of a published folder: one about a recording, and one with a card for each of several."""

from __future__ import annotations

import html
import shlex
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from string import Template

INDEX, STYLE = "index.html", "index.css"
SIZE = (1000, 640)  # pixels of a picture
_FRAME = "frame.html"  # the template around the others
_CLASS = "class.html"  # the template of the page with cards


@dataclass(frozen=True, slots=True)
class Figure:
    """A moment on the page."""

    heading: str
    details: Sequence[str]
    link: str  # to the viewer, paused at the moment
    pictures: Sequence[str]  # names of their files


@dataclass(frozen=True, slots=True)
class About:
    """The content of a page about a recording."""

    title: str
    file: str  # name of the recording when it is downloaded
    recording: str  # name of the published file
    size: int  # bytes of the recording
    viewer: str  # address of the viewer
    problems: Sequence[str]  # what went wrong, and warnings
    description: str  # of the scene
    headline: Sequence[tuple[str, str]]  # names and texts
    rows: Sequence[tuple[str, str]]  # of a table: names and texts
    scene: str  # the scene file; empty if the recording has none
    figures: Sequence[Figure]
    energy: str  # name of the picture of the energy; empty without one
    missing: str  # why there are no pictures, or fewer; empty if there are all


@dataclass(frozen=True, slots=True)
class Card:
    """A recording on the page of several."""

    page: str
    about: About
    picture: str  # name of its file; empty without one


def write_page(path: Path, about: About, *, back: bool) -> None:
    """Write the page about a recording, with a link ``back`` to the others or without one."""
    viewer = html.escape(about.viewer)
    scene = f"<details><summary>Scene file</summary><pre>{html.escape(about.scene)}</pre></details>"
    _write(
        path,
        INDEX,
        title=html.escape(about.title),
        back=f'<p><a href="{INDEX}">← All recordings</a></p>' if back else "",
        problems=_problems(about.problems),
        description=_paragraphs(about.description),
        headline=_headline(about.headline),
        viewer=viewer,
        recording=html.escape(about.recording),
        file=html.escape(about.file),
        quoted=html.escape(shlex.quote(about.file)),
        size=f"{about.size / 1e6:.3g} MB",
        missing=_missing(about.missing),
        moments="\n".join(map(_figure, about.figures)),
        energy=f"<h2>Energy</h2>{_image(about.energy, 'The energy over time')}" if about.energy else "",
        rows="\n".join(f"<tr><th>{html.escape(row)}</th><td>{html.escape(text)}</td></tr>" for row, text in about.rows),
        scene=scene if about.scene else "",
    )


def write_cards(folder: Path, title: str, cards: Sequence[Card]) -> None:
    """Write the page with a card for each recording."""
    missing = dict.fromkeys(card.about.missing for card in cards if card.about.missing)
    _write(
        folder / INDEX,
        _CLASS,
        title=html.escape(title),
        missing="".join(map(_missing, missing)),
        cards="\n".join(map(_card, cards)),
    )


def write_style(folder: Path) -> None:
    """Write the style of the pages."""
    (folder / STYLE).write_bytes((resources.files(__package__) / "page" / STYLE).read_bytes())


def _write(path: Path, template: str, title: str, **texts: str) -> None:
    """Write a page: the frame of all pages around the content of this one."""
    frame, content = (
        Template((resources.files(__package__) / "page" / name).read_text(encoding="utf-8"))
        for name in (_FRAME, template)
    )
    page = frame.substitute(title=title, content=content.substitute(texts, title=title))
    path.write_text(page, encoding="utf-8")


def _figure(figure: Figure) -> str:
    link = html.escape(figure.link)
    texts = (figure.heading, f"{figure.heading}, close up")
    images = [_image(picture, text) for picture, text in zip(figure.pictures, texts, strict=False)]
    shown = [f'<a href="{link}">{image}</a>' for image in images or ["Open this moment in the viewer"]]
    caption = f"<h2>{html.escape(figure.heading)}</h2><p>{_separated(figure.details)}</p>"
    return f'<figure><figcaption>{caption}</figcaption><div class="pictures">{"".join(shown)}</div></figure>'


def _card(card: Card) -> str:
    about, link = card.about, html.escape(card.page)
    picture = _image(card.picture, about.title) if card.picture else ""
    return (
        f'<article class="card"><a href="{link}">{picture}<h2>{html.escape(about.title)}</h2></a>'
        f"{_problems(about.problems[:1])}{_headline(about.headline)}"
        f'<p class="note">{html.escape(about.file)}</p></article>'
    )


def _image(name: str, alt: str) -> str:
    width, height = SIZE
    return f'<img src="{html.escape(name)}" alt="{html.escape(alt)}" width="{width}" height="{height}" />'


def _problems(problems: Sequence[str]) -> str:
    items = "".join(f"<li>{html.escape(text)}</li>" for text in problems)
    return f'<ul class="problems">{items}</ul>' if problems else ""


def _headline(headline: Iterable[tuple[str, str]]) -> str:
    facts = (f"<div><dt>{html.escape(name)}</dt><dd>{html.escape(text)}</dd></div>" for name, text in headline)
    return f'<dl class="headline">{"".join(facts)}</dl>'


def _paragraphs(text: str) -> str:
    """Return a text as paragraphs, which are separated by blank lines."""
    return "".join(f"<p>{html.escape(' '.join(part.split()))}</p>" for part in text.split("\n\n") if part.strip())


def _missing(reason: str) -> str:
    return f'<p class="note">Without pictures: {html.escape(reason)}</p>' if reason else ""


def _separated(details: Iterable[str]) -> str:
    return " · ".join(f"<span>{html.escape(detail)}</span>" for detail in details)
