"""Publishes recordings as a folder for any static host: pages with their moments, the viewer and the recordings."""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path

import xxhash

from carom.errors import RecordingError
from carom.recording.layout.blueprint import CLOSE_UP
from carom.recording.read.recording import Recording
from carom.recording.write.whole_file import Claim, write_whole
from carom.runs.output import is_link_of_another
from carom.runs.overview import description, headline, overview, problems
from carom.runs.telling_moments import telling_moments
from carom.scene.units.dimension import TIME
from carom.scene.wording import counted
from carom.show.picture import Shot, try_to_render
from carom.show.presentation import asked
from carom.show.web import index_page, site
from carom.show.web.index_page import About, Card, Figure
from carom.show.web.site import PageNames

LIST = "carom-page.json"  # lists the files of a publication with their digests
WHAT = "files of a page that carom published; `carom publish --force` replaces these and no others"
MOST_PROBLEMS = 20  # on a page
_BODIES, _ENERGY = "bodies", "energy"  # views
_PART = re.compile(r"\.[0-9a-f]{8}\.part")
_TAKEN = {"index", "viewer", "layout", "recording"}  # stems of other files


@dataclass(frozen=True, slots=True)
class Published:
    """Result of publishing."""

    path: Path
    size: int  # bytes
    moments: int
    picture: str  # the reason for missing pictures; otherwise empty
    pages: Sequence[str]  # one for each recording, in their order


def publish(recordings: Sequence[Recording], folder: Path, watch: Callable[[str], None] = lambda _: None) -> Published:
    """Write the folder; an earlier one by carom is replaced once the new one is complete.

    Parameters
    ----------
    recordings
        Whole runs, or clips. Each of several recordings has its own page, and a card on the index page.
    folder
        The folder to write.
    watch
        Called with a description of each stage.

    Raises
    ------
    RecordingError
        If a recording has no frame, or the folder cannot be written.
    """
    several = len(recordings) > 1
    all_names = _all_names(recordings) if several else [site.ONLY]
    title = counted(len(recordings), "recording") if several else recordings[0].title
    cards: list[Card] = []
    missing = ""
    with Claim(folder), _replacing(folder) as part:
        watch("the viewer")
        site.write_viewer(part, title)
        for recording, names in zip(recordings, all_names, strict=True):
            about = _write_recording(recording, part, names, missing, watch)
            missing = missing or about.missing
            index_page.write_page(part / names.page, about, back=several)
            pictures = [figure.pictures[0] for figure in about.figures if figure.pictures]
            impacts = [figure.pictures[0] for figure in about.figures if len(figure.pictures) > 1]
            cards.append(Card(names.page, about, next(iter([*impacts, *pictures[-1:]]), "")))
        if several:
            index_page.write_cards(part, title, cards)
        index_page.write_style(part)
        size = sum(file.stat().st_size for file in part.iterdir())
    moments = sum(len(card.about.figures) for card in cards)
    return Published(folder, size, moments, missing, [names.page for names in all_names])


def _all_names(recordings: Sequence[Recording]) -> list[PageNames]:
    """Return the names of several recordings' files, all different."""
    stems: list[str] = []
    for recording in recordings:
        stem = re.sub(r"[^a-z0-9]+", "-", recording.path.stem.lower()).strip("-")[:60] or "run"
        numbered = (stem if number == 1 else f"{stem}-{number}" for number in count(1))
        stems.append(next(name for name in numbered if name not in (*stems, *_TAKEN)))
    return [PageNames(stem) for stem in stems]


def _write_recording(
    recording: Recording, folder: Path, names: PageNames, missing: str, watch: Callable[[str], None]
) -> About:
    """Write the files of a recording, with pictures unless ``missing`` states why there are none."""
    name, units = recording.path.name, recording.units
    watch(name)
    shutil.copyfile(recording.path, folder / names.recording)
    site.write_layout(recording, folder / names.layout)
    moments, shots, links = telling_moments(recording), list[Shot](), list[str]()
    for number, moment in enumerate(moments, 1):
        shown = asked(recording, moment.request)
        site.write_moment(recording, shown.supplement, folder, names.moment(number))
        links.append(names.viewer(recording, shown.time, names.moment(number)))
        views = (_BODIES, CLOSE_UP) if moment.close else (_BODIES,)
        shots += [Shot(moment.request, view, folder / f"{names.moment(number)}-{view}.png") for view in views]
    shots.append(Shot(moments[-1].request, _ENERGY, folder / f"{names.moment(len(moments))}-{_ENERGY}.png"))
    if not missing:
        watch(f"{counted(len(shots), 'picture')} of {name}")
        missing = try_to_render(recording, shots, index_page.SIZE)
    made = [shot.out_png for shot in shots if shot.out_png.exists()]
    figures = [
        Figure(
            moment.heading,
            [f"t = {units.text(moment.time, TIME)}", *moment.details],
            link,
            [png.name for png in made if png.name.startswith(f"{names.moment(number)}-") and shots[-1].out_png != png],
        )
        for number, (moment, link) in enumerate(zip(moments, links, strict=True), 1)
    ]
    return About(
        title=recording.title,
        file=name,
        recording=names.recording,
        size=recording.path.stat().st_size,
        viewer=names.viewer(recording),
        problems=problems(recording, MOST_PROBLEMS),
        description=description(recording.scene_toml),
        headline=list(headline(recording)),
        rows=overview(recording),
        scene=recording.scene_toml,
        figures=figures,
        energy=shots[-1].out_png.name if shots[-1].out_png in made else "",
        missing=missing,
    )


def refuse_folder(folder: Path, force: bool) -> None:
    """Refuse an unsuitable folder before anything is computed.

    Raises
    ------
    RecordingError
        The message names the folder and a valid one.
    """
    if is_link_of_another(folder):
        raise RecordingError(f"{folder}: a link of another user; name another folder")
    if folder.is_file():
        raise RecordingError(f"{folder}: a file; name a folder to write")
    if not folder.resolve().parent.is_dir():
        raise RecordingError(f"{folder}: there is no folder {folder.parent}; make it first")
    if not folder.exists():
        return
    listed = _listed(folder)
    for path in sorted(folder.iterdir()):
        digest = listed.get(path.name)
        if path.name == LIST or digest == _digest(path) or (digest == "" and not _is_folder(path)):
            continue
        what = "was changed since carom wrote it" if digest is not None else "which carom did not write"
        raise RecordingError(f"{folder}: holds {path.name}, {what}; name another folder")
    if not force and listed:
        raise RecordingError(f"{folder}: exists; give --force to replace it, or name another with -o")


def _listed(folder: Path) -> dict[str, str]:
    """Return the digests of a publication's files by name; none without a list.

    The digest of a possibly incomplete file is empty.
    """
    try:
        stored = json.loads((folder / LIST).read_text(encoding="utf-8"))["files"]
        if any(Path(name).name != name or not isinstance(digest, str) for name, digest in stored.items()):
            raise ValueError("a name that is not a file of this folder")
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, TypeError, LookupError, AttributeError, RecursionError):
        raise RecordingError(f"{folder}: holds {LIST}, which carom did not write; name another folder") from None
    return dict(stored)


def _digest(path: Path) -> str:
    """Return the digest of a file; for a link or a folder, a text that no list contains."""
    if path.is_symlink() or not path.is_file():
        return "not a file"
    whole = xxhash.xxh3_128()
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            whole.update(piece)
    return whole.hexdigest()


@contextmanager
def _replacing(folder: Path) -> Iterator[Path]:
    """Yield an empty folder whose files move into this one on success; on failure nothing changes.

    Files are replaced one by one, since the folder may be a link, the current folder or a mounted disk. The list is
    written first, so that the next publication recognises the files even if this one is killed.
    """
    real, fresh = folder.resolve(), not folder.exists()
    try:
        real.mkdir(exist_ok=True)
        listed = before = _listed(real)
        part = real / f".{secrets.token_hex(4)}.part"
        try:
            _list(real, {**before, part.name: ""})
            part.mkdir(0o700)
            yield part
            made = {path.name: _digest(path) for path in part.iterdir()}
            listed = dict.fromkeys({*before, *made}, "")
            _list(real, {**listed, part.name: ""})
            for name in made:
                (part / name).replace(real / name)
            for name in before.keys() - made.keys():
                _remove(real / name)
            part.rmdir()
            listed = made
        finally:
            _remove(part)
            if listed:
                _list(real, listed)
            else:
                (real / LIST).unlink(missing_ok=True)
                if fresh:
                    real.rmdir()
    except OSError as error:
        raise RecordingError(f"cannot write {folder}: {error.strerror}") from None


def _list(folder: Path, files: dict[str, str]) -> None:
    write_whole(folder / LIST, json.dumps({"what": WHAT, "files": dict(sorted(files.items()))}, indent=1) + "\n")


def _remove(path: Path) -> None:
    """Remove a listed file, or the folder of a killed publication."""
    if _PART.fullmatch(path.name):
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)


def _is_folder(path: Path) -> bool:
    """Return whether a path is a folder, but not one of a killed publication."""
    return path.is_dir() and not path.is_symlink() and not _PART.fullmatch(path.name)
