"""`carom explain`: what will be modelled and why, and what it will cost."""

from __future__ import annotations

from typing import Annotated

import typer

from carom.cli.options import SceneArgument, SetOption


def explain(
    scene: SceneArgument,
    overrides: SetOption = None,
    as_json: Annotated[bool, typer.Option("--json", help="Print as JSON.")] = False,
) -> None:
    """Say what a scene requires and why, and what running it will cost."""
    import json
    from dataclasses import asdict

    from carom.cli.units import bytes_text, duration_text
    from carom.experiment.estimate import estimate
    from carom.scene.limits import refuse_impossible
    from carom.scene.requirements import require
    from carom.scene.schema import Scene

    loaded = Scene.load(scene, overrides)
    refuse_impossible(loaded)
    needs = require(loaded)
    cost = estimate(loaded)
    if as_json:
        parts = [asdict(part) for part in needs.parts]
        document = {"title": loaded.title, "bodies": loaded.count, "parts": parts, "cost": asdict(cost)}
        typer.echo(json.dumps(document, indent=2, ensure_ascii=False))
        return
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(f"[bold]{loaded.title}[/bold]: {loaded.count} bodies, {duration_text(loaded.time.duration)}\n")
    table = Table("part", "modelled", "why", box=None, pad_edge=False)
    for part in needs.parts:
        table.add_row(part.name, "[green]yes[/green]" if part.modelled else "[dim]no[/dim]", part.why)
    console.print(table)
    shares = ", ".join(f"{part} {share:.0%}" for part, share in cost.shares.items() if share >= 0.005)
    console.print(
        f"\nCost at the pace of the first steps (a collapse takes more of them later):\n"
        f"  about {cost.steps} steps in {duration_text(cost.seconds)}; a step is {shares}\n"
        f"  about {bytes_text(cost.memory)} of memory for the bodies\n"
        f"  about {bytes_text(cost.size)} of recording in {cost.frames} frames"
    )
