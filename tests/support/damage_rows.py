"""Changes the rows of a recording in one way after the other, and does to each what the commands do: run as a program.

    python damage_rows.py RECORDING FOLDER SEED COUNT

What bytes that were changed at random hardly ever get to: chunks that can be decoded, and hold something else.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import sys
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa

from carom.cli.contacts import _json
from carom.cli.contacts import _parts as contact_parts
from carom.cli.inspect import _parts
from carom.display.movie import _layout, frame_times
from carom.display.presentation import asked
from carom.display.request import Request
from carom.lab.diff.diff import diff
from carom.recording.edit.clip import clip
from carom.recording.layout import ALL
from carom.recording.layout.canvas import Canvas
from carom.recording.read.recording import Recording
from carom.recording.rrd.framing import CHUNK
from carom.recording.rrd.messages import RECORDING, decode
from carom.runs.outcome import description
from carom.runs.replay import replay
from carom.sharing import report
from carom.terminal.answers import print_parts
from damage_bytes import SLOWEST, attempt, mended, peak, read_all, tell
from edited_recordings import assembled, messages_of, repacked, stream, with_column, without_column

LONG = 3_000_000  # values of a bomb
TEXTS = ["", "[/red]", "\x1b[2J", "x" * 100_000, "[" * 100_000, "a." * 50_000, "[[" * 3000, "1,2,", "end: ", "nan"]
NUMBERS = [0.0, -1.0, np.nan, np.inf, 1e308, 5e-324, -0.0, 2.0**63, 1e18]
WHOLE = [0, 1, -1, 2**31, 2**62, -(2**63), 255]

Random = np.random.Generator


def values(random: Random, rows: int) -> pa.Array:
    """Make a component of rows of a kind at random."""
    each = int(random.choice([0, 1, 1, 1, 2, 3, 60]))
    kinds: list[Callable[[], pa.Array]] = [
        lambda: pa.array([[str(random.choice(TEXTS))] * min(each, 3)] * rows, pa.list_(pa.string())),
        lambda: pa.array([[float(random.choice(NUMBERS))] * each] * rows, pa.list_(pa.float64())),
        lambda: pa.array([[int(random.choice(WHOLE))] * each] * rows, pa.list_(pa.int64())),
        lambda: pa.array([[bool(random.integers(2))] * each] * rows, pa.list_(pa.bool_())),
        lambda: pa.array([[None] * each] * rows, pa.list_(pa.float64())),
        lambda: pa.array([None] * rows, pa.list_(pa.string())),
        lambda: pa.nulls(rows, pa.list_(pa.null())),
        lambda: pa.ListArray.from_arrays(pa.array([0] + [LONG] * rows, pa.int32()), pa.array(np.zeros(LONG))),
    ]
    return kinds[random.integers(len(kinds))]()


def mutated(batch: pa.RecordBatch, random: Random) -> pa.RecordBatch:
    """Change one column of a chunk, or take it or some rows away."""
    names = [name for name in batch.schema.names if name != "rerun.controls.RowId"]
    name = names[random.integers(len(names))]
    column = batch[name]
    match random.integers(6):
        case 0:
            return without_column(batch, name)
        case 1:
            return batch.slice(0, int(random.integers(batch.num_rows + 1)))
        case 2:
            return batch.take(pa.array(random.integers(batch.num_rows, size=batch.num_rows)))
        case 3 if pa.types.is_list(column.type) and pa.types.is_floating(column.type.value_type):
            flat = column.flatten().to_numpy().copy()
            flat[random.integers(len(flat), size=2) if len(flat) else []] = random.choice(NUMBERS)
            return with_column(
                batch, name, pa.ListArray.from_arrays(column.offsets, pa.array(flat, column.type.value_type))
            )
        case 4 if not pa.types.is_list(column.type):
            odd = np.array(random.choice(WHOLE, size=batch.num_rows), np.int64)
            return with_column(batch, name, pa.array(odd).cast(column.type))
    if pa.types.is_list(column.type):
        return with_column(batch, name, values(random, batch.num_rows))
    return without_column(batch, name)


def shown(path: Path) -> None:
    """Print what `carom inspect` prints."""
    recording = Recording.open(path)
    summary, units = recording.summary(), recording.units
    summary["description"] = description(recording.scene_toml)
    json.dumps(summary)
    with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stdout(nowhere):
        print_parts(_parts(summary, path, units))


def listed(path: Path, impacts: bool) -> None:
    """Print what `carom contacts` prints, as JSON and as a table."""
    recording = Recording.open(path)
    table = recording.impacts() if impacts else recording.contacts()
    with Path(os.devnull).open("w") as nowhere, contextlib.redirect_stdout(nowhere):
        _json(recording, table)
        print_parts(contact_parts(recording, table, None if impacts else 0.0))


def pictured(path: Path) -> None:
    """Plan a picture: what is shown of its moment, the close-up of a pair, and the plot of a body."""
    recording = Recording.open(path)
    asked(recording, Request(plot="3.speed"), Canvas(800, 500, framed=True))
    asked(recording, Request(2.0, bodies="3,17", colour_by="speed"), Canvas(800, 500, framed=True))


def filmed(path: Path) -> None:
    """Plan a movie."""
    recording = Recording.open(path)
    times = frame_times(recording, None, None, 20)
    _layout(recording, times.tolist(), Canvas(800, 500), ALL)


def tracked(path: Path) -> None:
    """Ask for the path of a body, and the state of all at a checkpoint and between two."""
    recording = Recording.open(path)
    attempt(lambda: recording.trajectory(3))
    attempt(lambda: recording.bodies(0.0))
    attempt(lambda: recording.bodies(2.01))


def reported(path: Path, out: Path) -> None:
    """Make a report without its picture."""
    report.report(Recording.open(path), out)


MANIFOLD = ("impacts", "world/contacts", "world/forces/normal", "world/forces/friction", "world/bodies")
LONGER: tuple[tuple[Callable[[Path, Path], object], ...], ...] = (  # of every fifth mutant each
    (mended,),
    (lambda path, out: pictured(path),),
    (lambda path, out: filmed(path), lambda path, out: tracked(path)),
    (lambda path, out: replay(Recording.open(path), threads=1),),
    (lambda path, out: reported(path, out.with_suffix(".zip")),),
)


def main(source: Path, folder: Path, seed: int, count: int) -> None:
    """Go through so many changes."""
    path, out = folder / "mutant.rrd", folder / "out.rrd"
    vars(report)["try_to_render"] = lambda *_: "not rendered"
    parts = messages_of(source)
    places: dict[str, list[int]] = {}
    for place, (kind, body) in enumerate(parts):
        if kind == CHUNK and decode(body)[0].kind == RECORDING:
            places.setdefault(decode(body)[1].entity_path, []).append(place)
    assert places.keys() >= set(MANIFOLD)
    for k in range(count):
        random = np.random.default_rng([seed, k])
        entity = random.choice(MANIFOLD if random.integers(3) == 0 else list(places))
        changed, place = list(parts), int(random.choice(places[entity]))
        chunk = decode(parts[place][1])[1]
        changed[place] = (CHUNK, repacked(parts[place][1], stream(mutated(chunk.batch, random))))
        tell(k, chunk.entity_path, peak())
        try:
            assembled(source, path, changed, footer=bool(random.integers(4)))
        except Exception as error:  # a chunk that our own reader refuses has no place in an index
            assembled(source, path, changed, footer=False)
            tell(k, "without footer:", str(error)[:60])
        used = resource.getrusage(resource.RUSAGE_SELF)
        spent = int(used.ru_utime + used.ru_stime)
        resource.setrlimit(resource.RLIMIT_CPU, (spent + SLOWEST, resource.RLIM_INFINITY))
        attempt(lambda: read_all(path))
        attempt(lambda: shown(path))
        attempt(lambda: listed(path, impacts=True))
        attempt(lambda: listed(path, impacts=False))
        attempt(lambda: clip(path, out, 1.0, 3.0, bodies=[3, 17]))
        attempt(lambda: diff(Recording.open(source), Recording.open(path)))
        for task in LONGER[k % len(LONGER)]:
            attempt(partial(task, path, out))
    tell("end", peak())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4]))
