"""`carom scenes` and `carom new`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from carom.cli.json_output import say_json
from carom.cli.options import ForceOption
from carom.scene.wording import command


def scenes(
    schema: Annotated[
        bool, typer.Option("--schema", help="Print the JSON schema of scene files, for editors.")
    ] = False,
    as_json: Annotated[bool, typer.Option("--json", help="Print the list as JSON.")] = False,
) -> None:
    """List the bundled scenes."""
    from carom.scene.scene_file import bundled_scenes, crosscheck_scenes, extreme_scenes
    from carom.scene.schema import Scene

    if schema:
        from carom.scene.format_page import schema_text

        typer.echo(schema_text(), nl=False)
        return
    found = {name: (path, Scene.load(path)) for name, path in bundled_scenes().items()}
    if as_json:
        rows = [
            {"name": name, "title": scene.title, "bodies": scene.count, "path": str(path)}
            for name, (path, scene) in found.items()
        ]
        say_json(rows)
        return
    from rich.table import Table

    from carom.cli.terminal import Terminal

    table = Table("scene", "what it is", "bodies", box=None, pad_edge=False)
    for name, (_, scene) in found.items():
        table.add_row(name, scene.title, str(scene.count))
    Terminal().print(table)
    typer.echo("\nRun one with `carom run NAME`; copy one with `carom new FILE --from NAME`.")
    typer.echo(f"`carom stress` runs the numerical extremes: {', '.join(extreme_scenes())}.")
    typer.echo(f"`carom crosscheck` runs bug reports of other engines: {', '.join(crosscheck_scenes())}.")


def new(
    name: Annotated[str, typer.Argument(metavar="NAME", help="File to write; .toml is added if missing.")],
    source: Annotated[
        str, typer.Option("--from", metavar="SCENE", help="Copy this bundled scene, such as incline or cradle.")
    ] = "",
    force: ForceOption = False,
) -> None:
    """Write a scene file to start from, with comments on the most important keys."""
    from carom.errors import SceneError
    from carom.recording.write.whole_file import whole_file, write_whole
    from carom.scene.format_page import without_schema_line
    from carom.scene.scene_file import bundled_scenes, crosscheck_scenes, data_files, extreme_scenes, starter

    if not Path(name).name or Path(name).is_dir():
        raise SceneError(f"{name}: a folder; name a file to write, such as {Path(name) / 'mine.toml'}")
    path = Path(name if name.endswith(".toml") else f"{name}.toml")
    bundled = bundled_scenes() | extreme_scenes() | crosscheck_scenes()
    if source not in bundled:  # cradle stands for newtons-cradle
        matches = [name for name in bundled_scenes() if source and source in name]
        source = matches[0] if len(matches) == 1 else source
    if source and source not in bundled:
        raise SceneError(f"--from {source}: there is no such bundled scene; choose one of {', '.join(bundled)}")
    if path.exists() and not force:
        raise SceneError(f"{path}: exists; give --force to replace it, or another name")
    text = without_schema_line(bundled[source].read_text(encoding="utf-8")) if source else starter()
    data = data_files(bundled[source]) if source else []
    for there in (path.with_name(file.name) for file in data):
        if there.exists() and not force:
            raise SceneError(f"{there}: exists; give --force to replace it")
    try:
        for file in data:
            with whole_file(path.with_name(file.name)) as part:
                part.write_bytes(file.read_bytes())
        write_whole(path, text)
    except OSError as error:
        raise SceneError(f"{path}: cannot be written: {error.strerror}") from None
    written = " and ".join(str(each) for each in (path, *(path.with_name(file.name) for file in data)))
    typer.echo(f"{written} written. Next: {command('explain', path)}, then {command('run', path)}")
