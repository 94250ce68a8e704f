"""`carom contacts`: the contacts at a moment, or the impacts of a run, with their impulses."""

from __future__ import annotations

from collections.abc import Iterator
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from carom.scene.units.dimension import ANGULAR_IMPULSE, ENERGY, FORCE, IMPULSE, TIME, VELOCITY
from carom.scene.wording import counted
from carom.terminal.answers import CommandAnswer, ShownColumn, ShownTable
from carom.terminal.given_moment import AtOption, EventOption, GivenMoment, StepOption, typed_time_or_none
from carom.terminal.options import (
    ForceOption,
    JsonOption,
    OptionalTime,
    RecordingArgument,
    output_option,
    time_option,
)
from carom.terminal.printing import say

if TYPE_CHECKING:
    import pyarrow as pa

    from carom.recording.read.recording import Recording
    from carom.terminal.answers import Part

MOST_ROWS = 40  # largest number of rows printed in the table
_ROUNDING = 1e-9  # relative rounding of the normal impulse and of its work at the approach speed
FORMATS = (".parquet", ".csv")  # suffixes of tables
FIGURES = (".png", ".svg")  # suffixes of figures of statistics

_MEASURED = {  # heading and dimension of a column of the table
    "approach_speed": ("approach", VELOCITY),
    "normal_impulse": ("normal", IMPULSE),
    "tangential_impulse": ("friction", IMPULSE),
    "energy_lost": ("lost", ENERGY),
}
_FORCES = {"normal_force": ("normal", FORCE), "tangential_force": ("friction", FORCE)}


_BODY = "Only contacts of this body. Two --body options: only contacts between these two."
_IMPACTS = "List the impacts of the run, or of an interval, instead of the contacts of a step."
_STATISTICS = "Measure statistics of the run, or of an interval: free paths, rates, stress and more."
_REPLAY = "Recompute the steps, for all rows and columns in double precision."
_OUTPUT = "File to write: .parquet or .csv; statistics also as a figure: .png or .svg."


def contacts(
    file: RecordingArgument,
    at: AtOption = None,
    step: StepOption = None,
    event: EventOption = None,
    bodies: Annotated[list[str] | None, typer.Option("--body", metavar="N|NAME", help=_BODY)] = None,
    impacts: Annotated[bool, typer.Option("--impacts", help=_IMPACTS)] = False,
    statistics: Annotated[bool, typer.Option("--statistics", help=_STATISTICS)] = False,
    start: Annotated[OptionalTime, time_option("--from", "First time of --impacts or --statistics.")] = None,
    end: Annotated[OptionalTime, time_option("--to", "Last time of --impacts or --statistics.")] = None,
    again: Annotated[bool, typer.Option("--replay", help=_REPLAY)] = False,
    as_json: JsonOption = False,
    as_csv: Annotated[bool, typer.Option("--csv", help="Print as CSV.")] = False,
    output: Annotated[Path | None, output_option("FILE", _OUTPUT)] = None,
    force: ForceOption = False,
) -> None:
    """List the contacts at a moment or all impacts, with impulses, modes and energies, or measure statistics.

    FILE may be the zip that `carom report` made. Contacts missing from the recording are recomputed.
    """
    from carom.errors import RecordingError
    from carom.recording.edit.bundle import opened
    from carom.recording.export import refuse_format
    from carom.recording.read.recorded_contacts import named_contacts
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import refuse_output
    from carom.terminal.console import replaying

    bodies = bodies or []
    if as_json + as_csv + (output is not None) > 1:
        raise RecordingError("give only one of --json, --csv and -o")
    if len(bodies) > 2:
        raise RecordingError(
            f"--body is given {len(bodies)} times; give it at most twice, once for each body of a contact"
        )
    if impacts and statistics:
        raise RecordingError("give only one of --impacts and --statistics")
    if statistics and bodies:
        raise RecordingError("--statistics cover all bodies; leave --body out")
    given = GivenMoment(at, step, event)
    if (impacts or statistics) and given.option:
        option = "--impacts" if impacts else "--statistics"
        raise RecordingError(f"{given.option} selects the contacts of one step; with {option}, use --from and --to")
    if not (impacts or statistics) and (start is not None or end is not None):
        raise RecordingError(
            "--from and --to select an interval; add --impacts or --statistics, or select one step with --at"
        )
    if output is not None:
        refuse_format(output, (*FORMATS, *FIGURES) if statistics else FORMATS)
        refuse_output(output, force)
    with opened(file) as path:
        recording = Recording.open(path)
        recording.refuse_overlay()
        start, end = (typed_time_or_none(recording, time) for time in (start, end))
        if statistics:
            _measure(recording, start, end, again, as_json, as_csv, output)
            return
        with replaying(recording) as watch:
            at = given.end(recording, watch)
        table = _table(recording, at, bodies, impacts, start, end, again)
        if output is not None:
            _write_table(named_contacts(recording, table), output)
            say(f"{output} written: {counted(table.num_rows, 'row')}, {_source(table)}.")
        elif as_csv:
            say(_csv_text(named_contacts(recording, table)))
        else:
            parts = _parts(recording, table, None if impacts else recording.moment(at))
            CommandAnswer(_json(recording, table), parts).say(as_json)


def _table(
    recording: Recording,
    at: OptionalTime,
    bodies: list[str],
    impacts: bool,
    start: OptionalTime,
    end: OptionalTime,
    again: bool,
) -> pa.Table:
    """Return the recording's contacts that involve the bodies."""
    from carom.errors import RecordingError
    from carom.recording.read.lookup import names_of, shown_body
    from carom.recording.read.recorded_contacts import of_body
    from carom.runs.recomputed import contacts_of, impacts_of
    from carom.terminal.console import replaying

    numbers = [shown_body(recording, body) for body in bodies]
    if len(set(numbers)) < len(numbers):
        raise RecordingError(f"--body {bodies[0]} --body {bodies[1]}: a body has no contact with itself")
    at = _hardest(recording, numbers) if at is None and numbers and not impacts else at
    with replaying(recording) as watch:
        if recording.engine and not again:
            from carom.engines.measured_contacts import measured_contacts, measured_impacts

            table = measured_impacts(recording, start, end) if impacts else measured_contacts(recording, at)
        elif impacts:
            table = impacts_of(recording, start, end, replay=again, watch=watch)
        else:
            table = contacts_of(recording, at, replay=again, watch=watch)
    for number in numbers:
        table = of_body(table, number)
    if len(numbers) == 2 and table.num_rows == 0:
        pair = names_of(recording).pair(numbers)
        when = "in that time" if impacts else f"at t = {recording.units.text(recording.moment(at), TIME, '.9g')}"
        raise RecordingError(f"{recording.path}: {pair} do not touch {when}")
    return table


def _measure(
    recording: Recording,
    start: OptionalTime,
    end: OptionalTime,
    again: bool,
    as_json: bool,
    as_csv: bool,
    output: Path | None,
) -> None:
    """Print or write the statistics of an interval (s)."""
    from carom.lab.statistics.statistics_report import Statistics, draw
    from carom.terminal.console import replaying

    with replaying(recording) as watch:
        statistics = Statistics.of(recording, start, end, again, watch)
    if output is not None and output.suffix in FIGURES:
        draw(statistics, output)
        say(f"{output} written.")
    elif output is not None:
        table = statistics.table()
        _write_table(table, output)
        say(f"{output} written: {counted(table.num_rows, 'row')}.")
    elif as_csv:
        say(_csv_text(statistics.table()))
    else:
        statistics.answer().say(as_json)


def _hardest(recording: Recording, bodies: list[int]) -> OptionalTime:
    """Return the time of the bodies' hardest recorded impact; None if there is none."""
    import numpy as np

    from carom.recording.read.recorded_contacts import of_body

    if not recording.records_contacts:
        return None
    table = recording.impacts()
    for body in bodies:
        table = of_body(table, body)
    if table.num_rows == 0:
        return None
    return float(table["time"][int(np.argmax(table["normal_impulse"].to_numpy()))].as_py())


def _write_table(table: pa.Table, path: Path) -> None:
    import pyarrow.csv as pc
    import pyarrow.parquet as pq

    from carom.errors import RecordingError
    from carom.recording.export.spreadsheet import in_csv
    from carom.recording.write.whole_file import whole_file

    try:
        with whole_file(path) as part:
            if path.suffix == ".csv":
                pc.write_csv(in_csv(table), part)
            else:
                pq.write_table(table, part)
    except OSError as error:
        raise RecordingError(f"cannot write {path}: {error.strerror or error}") from error


def _csv_text(table: pa.Table) -> str:
    import io

    import pyarrow.csv as pc

    from carom.recording.export.spreadsheet import in_csv

    out = io.BytesIO()
    pc.write_csv(in_csv(table), out)
    return str(out.getvalue().decode()).rstrip("\n")


def _json(recording: Recording, table: pa.Table) -> dict[str, Any]:
    from carom.recording.read.lookup import names_of

    names, about = names_of(recording), table.schema.metadata
    rows = [{**row, "between": [names.of(row["i"]), names.of(row["j"])]} for row in table.to_pylist()]
    counts = {key.decode(): int(about[key]) for key in (b"left_out", b"unsolved") if key in about}
    return {"source": about[b"source"].decode(), "units": recording.units.recorded, **counts, "contacts": rows}


def _source(table: pa.Table) -> str:
    """Describe the source of the rows, and say if rows are missing."""
    about = table.schema.metadata
    left_out = int(about.get(b"left_out", 0))
    more = f"; {left_out} smaller impacts were not recorded, list them with --replay" if left_out else ""
    if unsolved := int(about.get(b"unsolved", 0)):
        more = f"; {unsolved} further in clusters whose impulses are unknown"
    return f"{about[b'source'].decode()}{more}"


def _parts(recording: Recording, table: pa.Table, at: OptionalTime) -> Iterator[Part]:
    """Describe the contacts of the step that contains a time (s), or impacts if no time is given."""
    from carom.recording.read.lookup import names_of

    names = names_of(recording)
    count, units, moment = counted(table.num_rows, "impact" if at is None else "contact"), recording.units, ""
    if at is not None:  # impacts have their own times within the step
        moment = f" in step {table['step'][0]}" if table.num_rows else f" at t = {units.text(at, TIME, '.9g')}"
    note = "" if at is None else _named_faults(recording, at)
    if not recording.engine:
        note = "" if at is None or table.num_rows else _in_next_step(recording, at)
    if table["approach_speed"].null_count and not recording.engine:
        note = "; empty cells were not recorded, compute them with --replay"
    yield f"{count}{moment}, {_source(table)}{note}"
    if table.num_rows == 0:
        return
    measured = _MEASURED | (_FORCES if table["normal_force"].null_count < table.num_rows else {})
    columns = [
        ShownColumn("t", itemgetter("time"), TIME, ".9g"),
        ShownColumn("step", itemgetter("step")),
        ShownColumn("between", lambda row: names.pair((row["i"], row["j"])), left=True),
        ShownColumn("mode", itemgetter("mode"), left=True),
        *(ShownColumn(label, itemgetter(name), dimension) for name, (label, dimension) in measured.items()),
    ]
    if not table["angular_impulse_i"].null_count:
        normal, tangential = (table[f"{name}_impulse"].to_numpy() for name in ("normal", "tangential"))
        if (tangential > _ROUNDING * normal).any():  # a smaller angular impulse is rounding of the impulse
            ends = [ShownColumn("", itemgetter(f"angular_impulse_{end}"), ANGULAR_IMPULSE) for end in "ij"]

            def both(row: dict[str, Any]) -> str:
                return ", ".join(dict.fromkeys(filter(None, (end.cell(row, units) for end in ends))))

            columns.append(ShownColumn("angular", both, ANGULAR_IMPULSE))
    if at is None and "restitution" in table.column_names:
        columns.append(ShownColumn("e", lambda row: _coefficient(row, "restitution")))
        columns.append(ShownColumn("μ", lambda row: _coefficient(row, "friction")))
    rows = map(_without_rounding, table.slice(0, MOST_ROWS).to_pylist())
    yield ShownTable(columns, rows, units, indent=True)
    if table.num_rows > MOST_ROWS:
        yield f"… and {table.num_rows - MOST_ROWS} more; for all rows, use --csv, --json or -o FILE.parquet."


def _without_rounding(row: dict[str, Any]) -> dict[str, Any]:
    """Return a row in which friction and energies are 0 if they are rounding of the normal impulse."""
    impulse, approach = row["normal_impulse"], row["approach_speed"] or 0.0
    zeros: dict[str, float] = {}
    if row["tangential_impulse"] is not None and row["tangential_impulse"] <= _ROUNDING * impulse:
        rubbed = ("tangential_impulse", "tangential_force", "angular_impulse_i", "angular_impulse_j")
        zeros |= {name: 0.0 for name in rubbed if row[name] is not None}
    if row["energy_lost"] is not None and abs(row["energy_lost"]) <= _ROUNDING * impulse * approach:
        zeros["energy_lost"] = 0.0
    return row | zeros


def _coefficient(row: dict[str, Any], name: str) -> str:
    """Return a measured coefficient with its uncertainty; sticking friction is a lower bound."""
    value, error = row[name], row[f"{name}_error"]
    if value is None:
        return ""
    least = "≥ " if name == "friction" and row["mode"] == "sticking" else ""
    return f"{least}{value:.3g} ± {error:.1g}"


def _named_faults(recording: Recording, at: float) -> str:
    """Name the laws that were broken in the frame that contains a time (s)."""
    from carom.recording.read.lookup import frame_of

    row = frame_of(recording, at)
    step = None if row is None else recording.fingerprints()["step"][row].as_py()
    texts = [event.text for event in recording.warnings() if event.step == step and event.kind.startswith("law-")]
    return "".join(f"\n{text}" for text in texts)


def _in_next_step(recording: Recording, at: float) -> str:
    """Name the next step if it recorded impacts at the end of the step that contains a time (s)."""
    from carom.recording.read.lookup import frame_of

    row = frame_of(recording, at)
    if row is None or not recording.records_contacts:
        return ""
    own = recording.fingerprints()["step"][row].as_py()
    later = [step for step in recording.impacts(at, at)["step"].to_pylist() if step > own]
    if not later:
        return ""
    when = f"{recording.units.shown(at, TIME):.9g}"
    return f"; {counted(len(later), 'impact')} at this time in step {later[0]}: see --impacts --from {when} --to {when}"
