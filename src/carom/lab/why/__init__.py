"""`carom why`: the impacts, contacts and forces that gave a body its velocity, and their causes."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from carom.scene.units.dimension import ENERGY, IMPULSE, TIME, VELOCITY
from carom.scene.wording import command, counted
from carom.terminal.answers import CommandAnswer, Part, ShownColumn, ShownTable, Strong, markdown
from carom.terminal.given_moment import EventOption, GivenMoment, StepOption, at_option
from carom.terminal.options import (
    ForceOption,
    JsonOption,
    OptionalTime,
    RecordingArgument,
    recording_option,
    simulated_or_none,
    time_option,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from carom.arrays import FloatArray
    from carom.lab.why.account import Account, Cause
    from carom.lab.why.why import Answer
    from carom.recording.read.recording import Recording
    from carom.scene.units.system import UnitSystem
    from carom.scene.wording import Names


MOST_CAUSES = 12  # largest number of causes of a body that are printed; --json has all causes
MOST_EDGES = 8
MOST_TURNS = 3  # largest number of printed turns of one body in a row
_ROUNDED = 1e-3  # smallest unexplained part of a velocity, relative to the largest change, that is more than rounding
_SEEN = 0.005  # smallest share that is not printed as 0%
_OF_ENGINE = "Impulses are the engine's contact forces times the time between frames; the rest of a velocity's change"
_BODY = "The body whose velocity is in question."
_FROM = "Trace causes back to this time. Default: the earliest time that a few seconds of computing reach."


def why_command(
    file: RecordingArgument,
    body: Annotated[str | None, typer.Option("--body", metavar="N|NAME", help=_BODY)] = None,
    at: Annotated[OptionalTime, at_option("the end")] = None,
    step: StepOption = None,
    event: EventOption = None,
    start: Annotated[OptionalTime, time_option("--from", _FROM)] = None,
    output: Annotated[Path | None, recording_option("Write a recording of the causes for the viewer.")] = None,
    force: ForceOption = False,
    as_json: JsonOption = False,
) -> None:
    """Explain why a body moves as it does (--body), or why two bodies touch (--event): the chain of causes, backwards.

    The steps before the moment are run again, so any recording suffices; a recording of another engine needs the forces
    of its contacts. FILE may be the zip of `carom report`.
    """
    from carom.lab.why.history import question_of
    from carom.lab.why.why import why as answer_to
    from carom.recording.edit.bundle import opened
    from carom.recording.read.lookup import names_of
    from carom.recording.read.recording import Recording
    from carom.recording.write.whole_file import refuse_itself, refuse_output
    from carom.terminal.console import replaying

    given = GivenMoment(at, step, event)
    if output is not None:
        refuse_itself(output, file)
        refuse_output(output, force)
    with opened(file) as path:
        recording = Recording.open(path)
        recording.refuse_overlay()
        units = recording.units
        with replaying(recording) as watch:
            question = question_of(recording, body, given.time(recording, watch), event)
            answer = answer_to(recording, question, simulated_or_none(start, units), watch)
        names = names_of(recording)
        parts = list(_parts(answer, names, units, next(iter(recording.checkpoint_times))))
        further = [_look(answer, names, units, file)]
        if output is not None:
            _write(output, recording, answer, markdown(parts))
            further.append(f"{output} written; {command('view', output)}")
        CommandAnswer(_document(answer, names, units), [*parts, *filter(None, further)]).say(as_json)


def _document(answer: Answer, names: Names, units: UnitSystem) -> dict[str, Any]:
    from dataclasses import asdict

    question, cone = answer.question, answer.cone
    return {
        "units": units.recorded,
        "question": {
            "text": question.text,
            "bodies": list(question.bodies),
            "ends": None if question.ends is None else list(question.ends),
            "event": question.event,
            "time": answer.time,
            "step": answer.step,
        },
        "window": {"begin": answer.begin, "begin_step": answer.begin_step, "source": answer.source},
        "answer": answer.kind,
        "accounts": [_account_document(account, names, answer.knows_field) for account in answer.accounts],
        "chain": [asdict(link) | {"between": [names.of(link.by), names.of(link.body)]} for link in answer.chain],
        "first_cause": {"body": answer.first_cause, "name": names.of(answer.first_cause)},
        "cone": {
            "closed": answer.closed.tolist(),
            "bodies": [
                {
                    "body": int(b),
                    "since": float(cone.since[b]),
                    "start_share": float(cone.shares[b]),
                    "forces_share": float(cone.from_forces[b]),
                }
                for b in answer.bodies
            ],
            "edges": [asdict(edge) for edge in answer.edges],
        },
    }


def _account_document(account: Account, names: Names, knows_field: bool) -> dict[str, Any]:
    vectors = ("velocity", "start_velocity", "by_contacts", "by_forces")
    own = ("kind", "first", "last", "step", "moment", "work", "share", "turned", "approach_speed", "energy_lost")
    return {
        "body": account.body,
        "name": names.of(account.body),
        "mass": account.mass,
        **{name: getattr(account, name).tolist() for name in vectors},
        **{name: getattr(account, name) for name in ("unexplained", "rests", "start_share", "forces_share")},
        **({"by_gravity": account.by_field.tolist(), "gravity_share": account.field_share} if knows_field else {}),
        "causes": [
            {
                "with": cause.partner,
                "name": names.of(cause.partner),
                **{name: getattr(cause, name) for name in own},
                "impulse": cause.impulse.tolist(),
                "impulse_size": cause.size,
            }
            for cause in account.causes
        ],
    }


def _parts(answer: Answer, names: Names, units: UnitSystem, oldest: int) -> Iterator[Part]:
    """Describe an answer; ``oldest`` is the step of the recording's first checkpoint."""
    from carom.recording.read.lookup import tolerance

    yield Strong(answer.question.text)
    if answer.question.ends is None and abs(answer.time - answer.question.time) > tolerance(answer.question.time):
        where = "between two exact states" if answer.engine else "within a step"
        which = "the nearest one that is recorded" if answer.engine else "its end"
        yield f"That is {where}; the answer is about {which}, t = {units.text(answer.time, TIME, '.9g')}."
    for account in answer.accounts:
        yield ""
        yield from _summary(account, answer, names, units)
        if account.causes:
            yield _causes(account, names, units)
        if len(account.causes) > MOST_CAUSES:
            yield f"  … and {len(account.causes) - MOST_CAUSES} more; for all, use --json."
    yield ""
    yield from _behind(answer, names, units)
    yield f"From t = {units.text(answer.begin, TIME, '.9g')} on, {answer.source}."
    if answer.engine:
        also = ", without the part of its uniform field," if answer.knows_field else ""
        yield f"{_OF_ENGINE}{also} is due to forces, or to contacts that the engine does not report."
    if answer.begin_step > oldest:
        yield "Earlier causes were not examined; --from 0 goes back to the beginning."


def _look(answer: Answer, names: Names, units: UnitSystem, file: Path) -> str:
    """Return the command that shows the largest cause; empty without causes."""
    causes = [(cause, account.body) for account in answer.accounts for cause in account.causes]
    if not causes:
        return ""
    cause, body = max(causes, key=lambda each: each[0].share)
    low, high = sorted((body, cause.partner))
    pair = ("--bodies", f"{low},{high}") if high < len(names.bodies) else ()
    return f"Look: {command('view', file, '--at', f'{units.shown(cause.moment, TIME):.9g}', *pair)}"


def _summary(account: Account, answer: Answer, names: Names, units: UnitSystem) -> Iterator[str]:
    """Describe the velocity and the terms that add up to it."""
    at, since = (units.text(time, TIME, ".9g") for time in (answer.time, answer.begin))
    yield f"{names.of(account.body)}: {_speed(account.velocity, units)} at t = {at}, which is"
    kinds = [cause.kind for cause in account.causes]
    contacts = ", ".join(counted(kinds.count(kind), kind) for kind in ("impact", "stop", "contact") if kind in kinds)
    forces = [(account.by_forces, account.forces_share, "no contact explains" if answer.engine else "forces gave it")]
    if answer.knows_field:
        rest, share = account.by_forces - account.by_field, account.forces_share - account.field_share
        forces = [(account.by_field, account.field_share, "gravity gave it")]
        if np.linalg.norm(rest) > _ROUNDED * account.fastest or share > _ROUNDED:
            forces.append((rest, share, "no contact explains"))
    parts = (
        (account.start_velocity, account.start_share, f"it had at t = {since}"),
        *forces,
        (account.by_contacts, sum(cause.share for cause in account.causes), f"{contacts} gave it"),
    )
    for velocity, share, text in parts:
        if velocity.any() or share:
            yield f"  {_speed(velocity, units)}  {'' if account.rests else f'{share:5.0%}  '}{text}"


def _speed(velocity: FloatArray, units: UnitSystem) -> str:
    x, y, z = (units.shown(part, VELOCITY) for part in velocity.tolist())
    unit = f" {units.unit(VELOCITY)}" if units.unit(VELOCITY) else ""
    return f"{(x * x + y * y + z * z) ** 0.5:.4g}{unit} ({x:.3g}, {y:.3g}, {z:.3g})"


def _causes(account: Account, names: Names, units: UnitSystem) -> ShownTable:
    columns = [
        ShownColumn("look at t", lambda cause: cause.moment, TIME, ".9g"),
        ShownColumn("with", lambda cause: names.of(cause.partner), left=True),
        ShownColumn("kind", lambda cause: _kind(cause, units), left=True),
        ShownColumn("impulse", lambda cause: cause.size, IMPULSE),
        ShownColumn("work", lambda cause: cause.work, ENERGY, "+.4g"),
    ]
    if all(cause.energy_lost is not None for cause in account.causes):
        columns.append(ShownColumn("lost", lambda cause: cause.energy_lost, ENERGY))
    if not account.rests:
        columns.append(ShownColumn("of the speed", _share))
    return ShownTable(columns, account.largest[:MOST_CAUSES], units, indent=True)


def _share(cause: Cause) -> str:
    """Return the fraction of the velocity that a cause gave; if this is almost 0, the fraction that it turned round."""
    turns = cause.turned > abs(cause.share)
    return f"turned {cause.turned:.1%}" if turns else f"{cause.share:.1%}"


def _kind(cause: Cause, units: UnitSystem) -> str:
    if cause.last == cause.first and (cause.lasts or not cause.holds):
        return cause.kind
    return f"{cause.kind} for {units.text(cause.last - cause.first, TIME, '.3g')}"


def _behind(answer: Answer, names: Names, units: UnitSystem) -> Iterator[str]:
    """Describe where the impulses came from: a chain of impacts, a flow over contacts, or neither."""
    cone = answer.cone
    others = len(answer.bodies) - len(answer.question.bodies)
    resting = [account for account in answer.accounts if account.rests]
    if answer.is_flow:
        at_rest = f"hold {' and '.join(names.of(account.body) for account in resting)} still"
        yield (
            f"Contacts {at_rest if resting else 'at rest gave it more than impacts'}, so no single impact is the "
            "cause; the answer is a flow of impulse over contacts."
        )
        edges = sorted(answer.edges, key=lambda edge: -edge.impulse) if resting else answer.edges
        for edge in edges[:MOST_EDGES]:
            between = names.pair((edge.i, edge.j))
            impulse = units.text(edge.impulse, IMPULSE, ".4g")
            share = "" if resting else f"{edge.share:6.1%}  "
            yield f"  {share}{between}: {impulse} in {counted(edge.impulses, 'impulse')}"
    elif answer.chain:
        yield "The chain of causes, backwards:"
        what = "the velocity" if len(answer.question.bodies) == 1 else "both velocities"
        # only a few of the impacts in a row that turned one body round are printed
        for (_, turns), some in groupby(answer.chain, key=lambda link: (link.body, link.turns)):
            links = list(some)
            most = MOST_TURNS if turns else len(links)
            for link in links[:most]:
                at, impulse = units.text(link.time, TIME, ".9g"), units.text(link.impulse, IMPULSE, ".4g")
                by, body = names.of(link.by), names.of(link.body)
                if turns:
                    yield f"  t = {at}: {by} turns {body} round, {impulse}; {link.turned:.1%} of {what}"
                else:
                    yield f"  t = {at}: {by} hits {body}, {impulse}; {link.share:.1%} of {what} came this way"
            if len(links) > most:
                rest = counted(len(links) - most, "earlier impact")
                yield f"  … and {rest} that turned {names.of(links[0].body)} round"
        yield f"  {_first_cause(answer, names, units)}: it is the first cause."
    else:
        passed = cone.passed_to(answer.question.bodies)
        each = f", none of them more than {max(passed):.1%}" if len(passed) > 1 else ""
        yield (
            f"There is no chain of causes: {counted(len(passed), 'impact')} passed on {sum(passed):.1%} of the "
            f"velocity from other bodies{each}."
        )
    forces = float(cone.from_forces.sum())
    left = float(cone.shares.sum())
    bodies = f"{counted(others, 'other body')} of {cone.count - 1}" if others else "no other body"
    yield f"In all, {bodies} could have had an effect through contacts."
    since = units.text(answer.begin, TIME, ".9g")
    if len(resting) == len(answer.accounts):
        return
    further = {"what no contact explains" if answer.engine else "forces since then": forces}
    if answer.knows_field:
        field = float(cone.from_field.sum())
        further = {"gravity": field} | (
            {"what no contact explains": forces - field} if forces - field > _ROUNDED else {}
        )
    if walls := float(cone.from_walls.sum()):
        further["moving walls"] = walls
    parts = ", ".join(f"{what} {share:.0%}" for what, share in further.items())
    yield f"Overall contributions: velocities at t = {since} {left:.0%}{_whose(answer, names)}, {parts}."


def _whose(answer: Answer, names: Names) -> str:
    """Name the bodies whose velocities at the start contributed, if there are any other than those in question."""
    shares = answer.cone.shares
    largest = [body for body in np.argsort(-shares, kind="stable")[:MOST_TURNS].tolist() if shares[body] > _SEEN]
    if set(largest) <= set(answer.question.bodies):
        return ""
    rest = float(shares.sum() - shares[largest].sum())
    others = [f"others {rest:.0%}"] if rest > _SEEN else []
    return f" ({', '.join([*(f'{names.of(body)} {shares[body]:.0%}' for body in largest), *others])})"


def _first_cause(answer: Answer, names: Names, units: UnitSystem) -> str:
    """Describe where the chain of causes begins."""
    body, cone = answer.first_cause, answer.cone
    if body >= cone.count:
        return f"{names.of(body)} moves by itself"
    if cone.from_forces[body] > cone.shares[body]:
        unknown = "what no contact explains" if answer.engine else "forces"
        by = "gravity" if 2.0 * cone.from_field[body] > cone.from_forces[body] else unknown
        return f"{names.of(body)} gained its velocity from {by}"
    return f"{names.of(body)} already had its velocity at t = {units.text(answer.begin, TIME, '.9g')}"


def _write(out: Path, recording: Recording, answer: Answer, text: str) -> None:
    """Write a recording of the bodies and contacts behind an answer."""
    from carom.display.causes import CauseEdge, Causes, write_causes

    cone, question = answer.cone, answer.question
    edges = [
        CauseEdge(edge.i, edge.j, edge.first, edge.share, edge.impulse, edge.last)
        for edge in answer.edges
        if edge.j < cone.count
    ]
    share = cone.shares + cone.from_forces
    write_causes(out, recording, Causes(question.text, text, answer.begin, answer.time, question.bodies, share, edges))
