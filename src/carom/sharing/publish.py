"""Publishes recordings as a folder for any static host: pages with their moments, the viewer and the recordings."""

from __future__ import annotations

import json
import re
import secrets
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import xxhash

from carom.display.picture import Shot, try_to_render
from carom.display.presentation import asked
from carom.display.request import Request
from carom.display.supplement import has_trails
from carom.display.web import (
    NARROW_SIZE,
    ONLY,
    SIZE,
    About,
    Card,
    Figure,
    PageNames,
    narrow_name,
    write_cards,
    write_layout,
    write_moment,
    write_page,
    write_style,
    write_viewer,
)
from carom.errors import RecordingError
from carom.recording.layout import CLOSE_UP
from carom.recording.read.lookup import names_of
from carom.recording.read.recorded_impacts import numbered_impacts
from carom.recording.read.recording import Recording
from carom.recording.timelines import STEP
from carom.recording.write.whole_file import Claim, is_link_of_another, write_whole
from carom.runs.outcome import FAILURES, Moment, description, headline, moments, overview, problems
from carom.scene.units.dimension import ANGULAR_IMPULSE, ENERGY, IMPULSE, TIME, VELOCITY
from carom.scene.wording import counted
from carom.sharing.report import ENERGY_ERROR, worst_moment

LIST = "carom-page.json"  # name of the file that lists the files of a publication with their digests
WHAT = "files of a page that carom published; `carom publish --force` replaces these and no others"
MOST_PROBLEMS = 20  # largest number of problems on a page
_BODIES, _ENERGY = "bodies", "energy"  # names of views
_PART = re.compile(r"\.[0-9a-f]{8}\.part")
_TAKEN = {"index", "viewer", "layout", "recording"}  # stems of other files in the folder
MOST_IMPACTS = 10  # largest number of impacts that all become moments
HARDEST = 3  # if there are more impacts, this number of the hardest ones become moments
FAINTEST = 0.01  # smallest impulse that is shown, relative to the largest; weaker impacts explain nothing
_ROUNDING = 1e-9  # rounding relative to the normal impulse
DEEP = 0.01  # smallest overlap that is shown, relative to the smaller radius; shallower overlaps explain nothing


@dataclass(frozen=True, slots=True)
class Published:
    """Result of publishing."""

    path: Path
    size: int  # bytes of the folder
    moments: int
    picture: str  # the reason for missing pictures; empty if there are pictures
    pages: Sequence[str]  # pages of the recordings, in their order


def publish(recordings: Sequence[Recording], folder: Path, watch: Callable[[str], None] = lambda _: None) -> Published:
    """Write the folder; an earlier publication by carom is replaced once the new one is complete.

    Each of several recordings has its own page, and a card on the index page. ``watch`` receives a description of each
    stage. Raises RecordingError if a recording has no frame, or the folder cannot be written.
    """
    several = len(recordings) > 1
    all_names = [ONLY]
    if several:
        stems: list[str] = []  # names of each recording's files, all different
        for recording in recordings:
            stem = re.sub(r"[^a-z0-9]+", "-", recording.path.stem.lower()).strip("-")[:60] or "run"
            numbered = (stem if number == 1 else f"{stem}-{number}" for number in count(1))
            stems.append(next(name for name in numbered if name not in (*stems, *_TAKEN)))
        all_names = [PageNames(stem) for stem in stems]
    title = counted(len(recordings), "recording") if several else recordings[0].title
    cards: list[Card] = []
    missing = ""
    with Claim(folder), _replacing(folder) as part:
        watch("the viewer")
        write_viewer(part, title)
        for recording, names in zip(recordings, all_names, strict=True):
            about = _write_recording(recording, part, names, missing, watch)
            missing = missing or about.missing
            write_page(part / names.page, about, back=several)
            pictures = [figure.pictures[0] for figure in about.figures if figure.pictures]
            impacts = [figure.pictures[0] for figure in about.figures if len(figure.pictures) > 1]
            cards.append(Card(names.page, about, next(iter([*impacts, *pictures[-1:]]), "")))
        if several:
            write_cards(part, title, cards)
        write_style(part)
        size = sum(file.stat().st_size for file in part.iterdir())
    moments = sum(len(card.about.figures) for card in cards)
    return Published(folder, size, moments, missing, [names.page for names in all_names])


def _write_recording(
    recording: Recording, folder: Path, names: PageNames, missing: str, watch: Callable[[str], None]
) -> About:
    """Write the files of a recording, with pictures unless ``missing`` states why there are none."""
    name, units = recording.path.name, recording.units
    watch(name)
    shutil.copyfile(recording.path, folder / names.recording)
    write_layout(recording, folder / names.layout)
    moments, shots, links = telling_moments(recording), list[Shot](), list[str]()
    for number, moment in enumerate(moments, 1):
        shown = asked(recording, moment.request)
        write_moment(recording, shown.supplement, folder, names.moment(number))
        links.append(names.viewer(recording, shown.time, names.moment(number)))
        views = (_BODIES, CLOSE_UP) if moment.close else (_BODIES,)
        shots += [Shot(moment.request, view, folder / f"{names.moment(number)}-{view}.png") for view in views]
    shots.append(Shot(moments[-1].request, _ENERGY, folder / f"{names.moment(len(moments))}-{_ENERGY}.png"))
    if not missing:
        watch(f"{counted(len(shots), 'picture')} of {name}")
        missing = try_to_render(recording, shots, SIZE)
    narrow = [replace(shot, out_png=shot.out_png.with_name(narrow_name(shot.out_png.name))) for shot in shots]
    if not missing:
        missing = try_to_render(recording, narrow, NARROW_SIZE)
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
        narrow=all(shot.out_png.exists() for shot in narrow),
    )


def refuse_folder(folder: Path, force: bool) -> None:
    """Refuse an unsuitable folder before anything is computed.

    Raises
    ------
    RecordingError
        The message names the folder, and a valid one.
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
        is_folder = path.is_dir() and not path.is_symlink() and not _PART.fullmatch(path.name)
        if path.name == LIST or digest == _digest(path) or (digest == "" and not is_folder):
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
    """Yield an empty folder whose files move into ``folder`` on success; on failure, nothing changes.

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


@dataclass(frozen=True, slots=True)
class TellingMoment:
    """A moment, its caption, and the view that shows it."""

    step: int
    time: float  # s
    heading: str
    details: Sequence[str]
    request: Request
    close: bool = False  # whether the moment is an impact, which a close-up shows


def telling_moments(recording: Recording) -> list[TellingMoment]:
    """Choose the moments.

    The moments are the initial state if there are many bodies, all impacts if there are few (otherwise the hardest
    impacts and the moment with the most contacts), and the end. The worst moment of a run that went wrong, a deep
    overlap, and a large integration error are added. Raises RecordingError if the recording has no frame.
    """
    recording.require_frames()
    summary = recording.summary()
    extremes = {moment.name: moment for moment in moments(summary, recording.units)}
    impacts = list(_impacts(recording))
    chosen: list[TellingMoment] = []
    if impacts and len(impacts) <= MOST_IMPACTS and not summary["impacts"]["left_out"]:
        chosen = [moment for _, moment in impacts]
    else:
        if "impact" in extremes:
            between = summary["moments"]["impact"]["between"]
            hardest = _of_extreme(extremes["impact"], close=True)
            same = [one for _, one in impacts if one.step == hardest.step and between and between in one.heading]
            chosen.append(replace(same[0], heading=f"Hardest impact: {between}") if same else hardest)
        for _, moment in sorted(impacts, key=lambda one: -one[0]):
            if len(chosen) < HARDEST and all(moment.step != other.step for other in chosen):
                chosen.append(moment)
        if "contacts" in extremes:
            _add(chosen, _of_extreme(extremes["contacts"]))
    if not has_trails(recording):  # a trail shows where bodies came from
        _add(chosen, _frame(recording, 0, "At the start"))
    _add(chosen, _frame(recording, -1, "At the end"))
    if "overlap" in extremes and summary["moments"]["overlap"]["value"] > DEEP:
        _add(chosen, _of_extreme(extremes["overlap"], close=True))
    if "energy_error" in extremes and summary["moments"]["energy_error"]["value"] > ENERGY_ERROR:
        _add(chosen, _of_extreme(extremes["energy_error"]))
    if recording.warnings() or recording.outcome.startswith(FAILURES):
        time, why = worst_moment(recording)
        table = recording.fingerprints()
        row = min(int(np.searchsorted(table["time"].to_numpy(), time)), table.num_rows - 1)
        step = int(table[STEP][row].as_py())
        _add(chosen, TellingMoment(step, time, _capital(why.splitlines()[0]), (), Request(time)))
    return sorted(chosen, key=lambda moment: (moment.time, moment.step))


def _impacts(recording: Recording) -> Iterator[tuple[float, TellingMoment]]:
    """Yield impulse (N s) and moment of each instant at which an impact was hard enough."""
    numbers, table = numbered_impacts(recording)
    times = recording.fingerprints()["time"]
    impulse = np.nan_to_num(table["normal_impulse"].to_numpy())
    time = table["time"].to_numpy()
    inside = np.flatnonzero((time >= times[0].as_py()) & (time <= times[-1].as_py()))
    inside = inside[np.lexsort((-impulse[inside], time[inside]))]  # the hardest impact of an instant comes first
    _, firsts, counts = np.unique(time[inside], return_index=True, return_counts=True)
    loud = FAINTEST * impulse[inside].max(initial=0.0)
    names, units = names_of(recording), recording.units
    rubbing = ("tangential_impulse", "angular_impulse_i")
    for hardest, together in zip(inside[firsts].tolist(), counts.tolist(), strict=True):
        if impulse[hardest] < loud:
            continue
        row: dict[str, Any] = table.slice(hardest, 1).to_pylist()[0]
        number = int(numbers[hardest])
        others = f", and {counted(together - 1, 'impact')} at the same time" if together > 1 else ""
        rubs = row["tangential_impulse"] > _ROUNDING * row["normal_impulse"]
        measured = (
            ("approach {}", "approach_speed", VELOCITY),
            ("impulse {}", "normal_impulse", IMPULSE),
            ("friction {}", "tangential_impulse", IMPULSE),
            ("angular impulse {}", "angular_impulse_i", ANGULAR_IMPULSE),
            ("energy lost {}", "energy_lost", ENERGY),
        )
        details = [
            wording.format(units.text(row[name], dimension, ".4g"))
            for wording, name, dimension in measured
            if row[name] is not None and (name not in rubbing or rubs)
        ]
        heading = f"Impact {number}: {names.of(row['i'])} and {names.of(row['j'])}{others}"
        request = Request(event=f"impact:{number}")
        yield float(impulse[hardest]), TellingMoment(row[STEP], row["time"], heading, details, request, close=True)


def _of_extreme(moment: Moment, *, close: bool = False) -> TellingMoment:
    request = Request(event=moment.name)
    return TellingMoment(moment.step, moment.time, _capital(moment.text), (), request, close)


def _frame(recording: Recording, row: int, heading: str) -> TellingMoment:
    table = recording.fingerprints()
    step, time = (table[name][row].as_py() for name in (STEP, "time"))
    return TellingMoment(step, time, heading, (), Request(time))


def _add(chosen: list[TellingMoment], moment: TellingMoment) -> None:
    """Add a moment; if a moment of the same step exists already, only add the caption to it."""
    for place, other in enumerate(chosen):
        if other.step == moment.step:
            chosen[place] = replace(other, details=(*other.details, moment.heading))
            return
    chosen.append(moment)


def _capital(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}"
