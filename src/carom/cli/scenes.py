"""`carom scenes`, `carom new` and `carom explain`: list scenes, write a new one, show a scene's model and cost."""

from __future__ import annotations

from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom.scene.units.dimension import TIME
from carom.scene.wording import command, counted
from carom.terminal.answers import CommandAnswer, Part, ShownColumn, ShownTable, materials_table, print_parts
from carom.terminal.given_moment import EventOption, GivenMoment, StepOption, at_option
from carom.terminal.options import ForceOption, JsonOption, OptionalTime, SceneArgument, SetOption
from carom.terminal.printing import bytes_text, count_text, duration_text, say_json, simulated_text

if TYPE_CHECKING:
    from rich.table import Table

    from carom.runs.estimate import Cost, EntityCost
    from carom.scene.load import Scene


HALF_A_PERCENT = 0.005  # a smaller share rounds to 0 %
_SCHEMA = "Print the JSON schema of scene files, for editors."
_FROM = (
    "Copy this bundled scene, such as incline or cradle, or begin with a state of this recording, which may be of "
    "another engine."
)
_PART = "Switch on a part of the model that the scene does not require. Repeatable."


def scenes(
    schema: Annotated[bool, typer.Option("--schema", help=_SCHEMA)] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the list as JSON.")] = False,
) -> None:
    """List the bundled scenes."""
    from carom.scene.load import Scene
    from carom.scene.scene_file import bundled_scenes, crosscheck_scenes, extreme_scenes

    if schema:
        from carom.scene.format_page import schema_text

        typer.echo(schema_text(), nl=False)
        return
    found = {name: (Scene.load(path), str(path)) for name, path in bundled_scenes().items()}
    rows = [(name, scene.title, scene.count, path) for name, (scene, path) in found.items()]
    document = [dict(zip(("name", "title", "bodies", "path"), row, strict=True)) for row in rows]
    labels = enumerate(("scene", "what it is", "bodies"))
    parts: list[Part] = [
        ShownTable([ShownColumn(label, itemgetter(k), left=True) for k, label in labels], rows),
        "\nRun one with `carom run NAME`; copy one with `carom new FILE --from NAME`.",
        f"`carom stress` runs the numerical extremes: {', '.join(extreme_scenes())}.",
        f"`carom crosscheck` runs bug reports of other engines: {', '.join(crosscheck_scenes())}.",
    ]
    CommandAnswer(document, parts).say(as_json)


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="File to write; .toml is added if missing.")],
    source: Annotated[str, typer.Option("--from", metavar="SCENE|FILE", help=_FROM)] = "",
    at: Annotated[OptionalTime, at_option("the frame before the first broken law, or the first frame")] = None,
    step: StepOption = None,
    event: EventOption = None,
    force: ForceOption = False,
) -> None:
    """Write a scene file to start from, with comments on the most important keys.

    From a recording, the scene has the exact state at the moment. If another engine made the recording, the scene has
    the coefficients that the impacts show.
    """
    from carom.errors import SceneError
    from carom.recording.write.whole_file import whole_file, write_whole
    from carom.scene.format_page import without_schema_line
    from carom.scene.scene_file import bundled_scenes, crosscheck_scenes, data_files, extreme_scenes, starter

    if not Path(name).name or Path(name).is_dir():
        raise SceneError(f"{name}: a folder; name a file to write, such as {Path(name) / 'mine.toml'}")
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    given = GivenMoment(at, step, event)
    if Path(source).is_file():
        _from_recording(path, Path(source), given, force)
        return
    if given.option:
        raise SceneError(f"{given.option} selects a state of a recording: name its file with --from")
    bundled = bundled_scenes() | extreme_scenes() | crosscheck_scenes()
    if source and source not in bundled:  # "cradle" also finds "newtons-cradle"
        matches = [name for name in bundled_scenes() if source in name]
        if len(matches) != 1:
            raise SceneError(f"--from {source}: there is no such bundled scene; choose one of {', '.join(bundled)}")
        source = matches[0]
    if path.exists() and not force:
        raise SceneError(f"{path}: exists; give --force to replace it, or another name")
    text = without_schema_line(bundled[source].read_text(encoding="utf-8")) if source else starter()
    copies = {path.with_name(file.name): file for file in (data_files(bundled[source]) if source else [])}
    for copy in copies:
        if copy.exists() and not force:
            raise SceneError(f"{copy}: exists; give --force to replace it")
    try:
        for copy, file in copies.items():
            with whole_file(copy) as part:
                part.write_bytes(file.read_bytes())
        write_whole(path, text)
    except OSError as error:
        raise SceneError(f"{path}: cannot be written: {error.strerror}") from None
    written = " and ".join(map(str, (path, *copies)))
    typer.echo(f"{written} written. Next: {command('explain', path)}, then {command('run', path)}")


def _from_recording(path: Path, source: Path, given: GivenMoment, force: bool) -> None:
    """Write a scene that begins with a state of a recording."""
    from carom.engines.scene_of_frame import scene_of_frame
    from carom.recording.edit.bundle import opened
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import refuse_output, write_whole
    from carom.terminal.console import replaying

    refuse_output(path, force)
    chosen = () if given.option is None else (given.option, given.given)
    with opened(source) as file:
        recording = Recording.open(file)
        with replaying(recording) as watch:
            moment = given.end(recording, watch)
        text = scene_of_frame(recording, moment, command("new", path.name, "--from", source, *chosen))
    write_whole(path, text)
    typer.echo(f"{path} written. Next: {command('explain', path)}, then {command('run', path)}")


def explain(
    scene: SceneArgument,
    overrides: SetOption = None,
    parts: Annotated[list[str] | None, typer.Option("--model", metavar="PART", help=_PART)] = None,
    as_json: JsonOption = False,
) -> None:
    """Show what parts of the model a scene needs and why, and estimate the cost of the run and the size of its file."""
    import json
    from dataclasses import asdict

    from carom.errors import SceneError
    from carom.recording.schema.header import ShownMaterials
    from carom.runs.estimate import estimate
    from carom.scene.load import Scene
    from carom.scene.parts import PARTS, unknown
    from carom.terminal.compilation import announce_compilation
    from carom.terminal.console import LiveLine, Patience, Terminal
    from carom.terminal.progress import notes_on, preparing, watch_look_ahead

    changes, further = list(overrides or []), parts or []
    for part in further:
        if part not in PARTS:
            raise SceneError(f"--model {part}: {unknown(part)}")
    loaded = Scene.load(scene, changes)
    if further:
        loaded = Scene.load(scene, [*changes, f"model.force={json.dumps([*loaded.model.force, *further])}"])
    announce_compilation()
    line = LiveLine(quiet=as_json)
    looks = loaded.time.accuracy is not None and loaded.promise is None
    with preparing(loaded, line) if looks else Patience("making a trial run …", line) as patience:
        found = estimate(loaded, watch_look_ahead(loaded, patience))
    materials, notes = ShownMaterials.of(loaded), notes_on(loaded)
    if as_json:
        own = {"title": loaded.title, "bodies": loaded.count, "units": loaded.unit_system.recorded}
        document = own | asdict(found)
        if materials:
            document["materials"] = materials.described
        if notes:
            document["notes"] = notes
        say_json(document)
        return
    console, cost = Terminal(), found.cost
    console.print(loaded.title, style="bold", end="")
    console.print(f": {counted(loaded.count, 'body')}, {simulated_text(loaded.time.duration, loaded.unit_system)}\n")
    for note in notes:
        console.print(note)
    if notes:
        console.print()
    shown = _table("part", "time")
    for each in found.parts:
        share = f"in {each.within}" if each.within else _percent(each.share)
        _add(shown, each.name, each.modelled, share, each.why)
    console.print(shown)
    if materials:
        console.print()
        print_parts([materials_table(materials.described)])
    console.print()
    console.print(_entities(found.entities))
    if loaded.time.fixed_dt is not None:
        basis = "Estimated from a trial run"
    elif cost.looked_until >= loaded.time.duration:
        basis = "Estimated from a trial of the whole run with long steps"
    else:
        basis = "Estimated from a trial of a part of the run with long steps"
    console.print(
        f"\n{basis}:\n"
        f"{_steps(cost, loaded)}\n"
        f"  about {bytes_text(cost.size)} of recording: {counted(cost.frames, 'frame')} in "
        f"{duration_text(cost.frames * cost.frame_seconds)} of a thread of its own\n"
        f"  {duration_text(cost.start_seconds)} to load libraries and kernels, and to close the file\n"
        f"  in all about {duration_text(cost.seconds)} of computing, and {bytes_text(cost.memory)} of memory"
    )
    for remark in filter(None, (_kernels(cost), found.shortfall, found.slow)):
        console.print(f"\n{remark}")


def _kernels(cost: Cost) -> str:
    """Say which kernels were compiled, or which kernels another machine compiles first."""
    from carom.plan.features import VARIANT_SECONDS

    own = f"kernels of their own: {', '.join(cost.own_kernels)}" if cost.own_kernels else ""
    if cost.compiled:
        made = f"{counted(cost.compiled, 'kernel')} compiled just now, once on this machine, in "
        return "; ".join(filter(None, (made + duration_text(cost.compile_seconds), own)))
    least, most = VARIANT_SECONDS
    return f"{own}; a machine that lacks them first compiles them, in {least:g} to {most:g} s" if own else ""


def _steps(cost: Cost, scene: Scene) -> str:
    """Describe the number of steps, their limits, and how to make them longer."""
    from carom.physics.diagnostics.run_monitor import remedies_of

    seconds = cost.step_seconds / cost.steps
    if cost.looked_until >= scene.time.duration:
        named = counted(1, "step") if cost.steps == 1 else f"{count_text(cost.steps)} steps"
        count = f"  about {named} in {duration_text(cost.step_seconds)}"
    else:
        fewest, most, steps = (count_text(n) for n in (cost.fewest_steps, cost.most_steps, cost.steps))
        count = (
            f"  {fewest} to {most} steps, by the latest pace {steps}, in "
            f"{duration_text(cost.fewest_steps * seconds)} to {duration_text(cost.most_steps * seconds)} "
            f"(seen up to t = {scene.unit_system.text(cost.looked_until, TIME, '.4g')})"
        )
    shares = ", ".join(f"{limit} {_percent(share)}" for limit, share in cost.limits.items() if share >= HALF_A_PERCENT)
    # there is no remedy if the integrator's own error sets the step
    remedy = remedies_of(scene).get(next(iter(cost.limits)))
    return f"{count}\n  set by: {shares}" + (f"; for fewer steps, raise {remedy}" if remedy else "")


def _table(first: str, share: str) -> Table:
    from rich.table import Table

    table = Table(box=None, pad_edge=False)
    for header in (first, "", share, "why"):
        table.add_column(header, justify="right" if header == share else "left", overflow="fold")
    return table


def _entities(entities: list[EntityCost]) -> Table:
    """Show the entities: a row for each folder and reason, and one row for the entities that are not recorded."""
    from carom.recording.schema.series import ONCE

    rows: dict[tuple[str, str], list[EntityCost]] = {}
    for entity in entities:
        folder = "" if entity.why == ONCE else entity.path.rpartition("/")[0]
        rows.setdefault((folder, entity.why if entity.recorded else ""), []).append(entity)
    table = _table("recorded", "bytes")
    for (folder, why), alike in rows.items():
        names = ", ".join(entity.path.removeprefix(f"{folder}/") for entity in alike)
        reasons = why or "no " + ", ".join(dict.fromkeys(entity.why.removeprefix("no ") for entity in alike))
        share = _percent(sum(entity.share or 0.0 for entity in alike) if why else None)
        _add(table, f"{folder}/{names}" if folder else names, bool(why), share, reasons)
    return table


def _add(table: Table, name: str, is_there: bool, share: str, why: str) -> None:
    table.add_row(name, "yes" if is_there else "no", share, why, style=None if is_there else "dim")


def _percent(share: float | None) -> str:
    if share is None:
        return "—"
    return "<1 %" if 0.0 < share < HALF_A_PERCENT else f"{100 * share:.0f} %"
