"""`carom hunt`: search for scenes that break a law."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from carom.scene.wording import counted
from carom.terminal.options import JsonOption, output_option, work_time
from carom.terminal.printing import say, say_json

if TYPE_CHECKING:
    from carom.lab.hunt.hunt import Hunt, Miss, Tally

_BUDGET = "How long to hunt, such as 60s or 2h. Default: 10min."
_SEED = "Random seed; the same seed draws the same scenes. Default: a new one."
_ALONE = "Run each scene in a process of its own, too: its bits must not depend on the scenes before it."
_FOLDER = Path("recordings/hunt")


def hunt_command(
    seconds: Annotated[
        float, typer.Option("--budget", parser=work_time, metavar="TIME", help=_BUDGET, show_default=False)
    ] = 600.0,
    seed: Annotated[int | None, typer.Option("--seed", metavar="N", help=_SEED, min=0)] = None,
    first: Annotated[int, typer.Option("--from", metavar="N", help="Number of the first scene.", min=0)] = 0,
    scenes: Annotated[int | None, typer.Option("--scenes", metavar="N", help="Check at most N scenes.", min=1)] = None,
    alone: Annotated[bool, typer.Option("--alone", help=_ALONE)] = False,
    folder: Annotated[Path, output_option("DIR", "Folder for the scenes and recordings of violations.")] = _FOLDER,
    as_json: JsonOption = False,
) -> None:
    """Draw random scenes and check each against the laws: ledger, momenta, impulses, replay, stated errors.

    The first violation of each law is shrunk and saved as a scene with its recording. Exit with 1 after a violation.
    """
    import secrets

    from carom.lab.hunt.hunt import Hunt, as_document

    chosen = secrets.randbelow(2**32) if seed is None else seed
    hunting = Hunt(chosen, folder, seconds, first, scenes, alone=alone)
    if not as_json:
        say(f"seed {chosen}")
    tally = _watched(hunting, quiet=as_json)
    if as_json:
        say_json(as_document(tally))
    else:
        whole = tally.scenes - tally.refused - tally.stated - tally.given_up
        ends = f"{tally.refused} refused, {tally.stated} ended with an error, {tally.given_up} abandoned as too long"
        say(f"{counted(tally.scenes, 'scene')} in {tally.seconds:.3g} s: {whole} ran to the end, {ends}.")
        if not tally.misses:
            say("No law was broken.")
        for miss in tally.misses:
            say(_said(tally, miss))
    if tally.misses:
        raise typer.Exit(1)


def _watched(hunt: Hunt, *, quiet: bool) -> Tally:
    from carom.terminal.compilation import announce_compilation
    from carom.terminal.console import Terminal

    console = Terminal(stderr=True, quiet=quiet)
    if not quiet:
        announce_compilation()
    with console.status("hunting") if console.is_terminal else nullcontext() as status:
        told = 0

        def watch(tally: Tally) -> None:
            nonlocal told
            for miss in tally.misses[told:]:  # prints misses at once, since a hunt may take hours
                console.print(_said(tally, miss), soft_wrap=True)
            told = len(tally.misses)
            if status:
                status.update(f"{counted(tally.scenes, 'scene')}, {counted(told, 'miss')}, {tally.seconds:.0f} s")

        hunt.watch = watch
        return hunt.hunt()


def _said(tally: Tally, miss: Miss) -> str:
    where = (
        f"{miss.path}, {counted(miss.bodies, 'body')}"
        if miss.path
        else "not saved, since a scene that breaks this law is saved already"
    )
    return f"{miss.law}: scene {miss.index} of seed {tally.seed}: {miss.said}: {where}"
