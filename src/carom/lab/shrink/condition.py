"""Conditions that a reduced scene must keep, as given to `carom shrink --while`."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

from carom.errors import ExperimentError
from carom.lab.run_summary import LASTING, SUNK, Expression, Observation, Pair, UnknownNameError, end_name
from carom.lab.shrink.trials import Condition
from carom.lab.shrink.whole_run import MovesWithSteps, ReplayDiffers, Varies
from carom.runs.outcome import Verdict
from carom.scene.schema.promise import Expect
from carom.scene.start import names_of_solids
from carom.scene.units.dimension import TIME
from carom.scene.wording import Names, nearest, suggestion

WARNINGS = ("energy-rise", "energy-ledger", "energy-lost", "dissipation", "limit", "pace", "horizon")
_MET = re.compile(r"\s*impact of (.+?) and (.+?)\s*")
_PROMISE = re.compile(r"\s*expect(?:\.([a-z_]+))?\s*")
_WARNING = re.compile(r"\s*warning(?: ([a-z-]+))?\s*")
_INVARIANCE = re.compile(r"\s*invariance ([a-z]+)\s*")
_ABOUT = {  # moments in a summary, by the names to which they relate
    "energy_error": re.compile(r"energy\.|moments\.energy_error"),
    "overlap": re.compile(r"contacts\.max_overlap|moments\.overlap"),
    "impact": re.compile(r"moments\.impact"),
}
_NUMBER = re.compile(r"[-+]?\d[\d.]*(?:e[-+]?\d+)?", re.IGNORECASE)
_BODIES = re.compile(r'(?:body N(?: "[^"]*")?(?:, | and )?|N more)+')


def condition_from(text: str | None) -> Condition:
    """Read a condition; raises ExperimentError if the text is not a condition.

    None means any error or missed promise. Otherwise the text is ``expect`` or ``expect.NAME`` (a missed promise),
    ``impact of A and B``, ``warning KIND``, ``PhysicsError``, ``crash`` (any other error), ``not finite``, ``overlap at
    rest``, ``replay differs``, ``shorter steps differ``, ``invariance NAME``, or an expression over the numbers of
    ``carom inspect --json``.
    """
    if text is None:
        return MissedPromise("expect", or_error=True)
    if matched := _PROMISE.fullmatch(text):
        return MissedPromise(text, matched[1] or "")
    if matched := _MET.fullmatch(text):
        return Met(text, matched[1], matched[2])
    if matched := _WARNING.fullmatch(text):
        return Warned(text, matched[1] or "")
    if matched := _INVARIANCE.fullmatch(text):
        return Varies(text, matched[1])
    match " ".join(text.lower().split()):
        case "replay differs":
            return ReplayDiffers(text)
        case "shorter steps differ":
            return MovesWithSteps(text)
        case "overlap at rest":
            return Sunk(text)
        case "crash":
            return Failed(text, stated=False)
        case "not finite":
            return Failed(text, about="no longer finite")
        case "physicserror":
            return Failed(text)
    return Measured(text, Expression(text))


@dataclass(frozen=True, slots=True)
class MissedPromise(Condition):
    """A missed promise of [expect]."""

    name: str = ""  # name of the criterion; empty: the first missed criterion
    note: str | None = None  # explains the measured value; None before the first run
    or_error: bool = False  # whether a run that ends with an error also meets the condition

    def check(self, seen: Observation) -> None:
        """Check the name of the promise."""
        given = [verdict.name for verdict in seen.verdicts]
        if not given and not self.or_error:
            raise ExperimentError("nothing to shrink: the scene has no [expect]; state the failure with --while")
        if self.name and self.name not in given:
            known = self.name in Expect.model_fields
            hint = "[expect] does not have it" if known else suggestion(self.name, Expect.model_fields)
            raise ExperimentError(f"--while {self.text}: no promise {self.name}; {hint}")

    def pinned(self, seen: Observation) -> Condition:
        """Return the condition that a run misses the same promise, with the same quantity."""
        if seen.error and self.or_error:
            return Failed("PhysicsError").pinned(seen)
        if seen.error:
            raise ExperimentError(
                f'nothing to shrink: the run failed: {seen.error} (shrink that failure with --while "PhysicsError")'
            )
        if not seen.verdicts:
            raise ExperimentError("nothing to shrink: the scene has no [expect]; state the failure with --while")
        missed = self._missed(seen)
        if not missed:
            shown = "; ".join(str(verdict) for verdict in seen.verdicts if self.name in ("", verdict.name))
            raise ExperimentError(f"nothing to shrink: every promise is kept: {shown}")
        return replace(self, name=missed[0].name, note=missed[0].note)

    def holds(self, seen: Observation) -> bool:
        """Return whether the promise is missed."""
        return not seen.error and any(self.note in (None, verdict.note) for verdict in self._missed(seen))

    def said(self, seen: Observation) -> str:
        """Return the promise with the measured value."""
        return "; ".join(str(verdict) for verdict in self._missed(seen))

    def bodies(self, seen: Observation) -> set[str]:
        """Return the bodies where the promise was missed most."""
        worst = [verdict.worst for verdict in self._missed(seen) if verdict.worst]
        return {seen.space.names[body] for extreme in worst for body in extreme.bodies}

    def _missed(self, seen: Observation) -> list[Verdict]:
        return [verdict for verdict in seen.verdicts if not verdict.met and self.name in ("", verdict.name)]


@dataclass(frozen=True, slots=True)
class Measured(Condition):
    """An expression over the numbers of the summary."""

    expression: Expression
    failed: bool = False  # whether the run ends with a PhysicsError

    def check(self, seen: Observation) -> None:
        """Check all names, except names of moments, which may not exist yet."""
        for name in self.expression.unknown(seen.summary):
            if not name.startswith("moments."):
                raise ExperimentError(self.expression.explain_unknown(name, seen.summary))

    def pinned(self, seen: Observation) -> Measured:
        """Return the condition that the expression holds for a run with the same ending."""
        try:
            if not self.expression.holds(seen.summary):
                raise ExperimentError(f"nothing to shrink: {self.expression.measured(seen.summary)}")
        except UnknownNameError as error:
            raise ExperimentError(self.expression.explain_unknown(error.name, seen.summary)) from None
        return replace(self, failed=bool(seen.error))

    def holds(self, seen: Observation) -> bool:
        """Return whether the expression holds."""
        if bool(seen.error) != self.failed:
            return False
        try:
            return self.expression.holds(seen.summary)
        except UnknownNameError:
            return False

    def said(self, seen: Observation) -> str:
        """Return the values of the expression's names."""
        return self.expression.measured(seen.summary)

    def bodies(self, seen: Observation) -> set[str]:
        """Return the bodies of the related moments, or of the largest energy error."""
        moments = seen.summary["moments"]
        named = {moment for name in self.expression.names for moment, about in _ABOUT.items() if about.match(name)}
        return {
            seen.space.names[body]
            for key in named or {"energy_error"}
            if key in moments
            for body in moments[key]["bodies"]
        }


@dataclass(frozen=True, slots=True)
class Met(Condition):
    """An impact of two bodies, or of a body and a plane."""

    first: str  # number or name of one end
    second: str
    pair: Pair | None = None  # names of the pair's ends; None before the first run
    needs_impacts = True

    def check(self, seen: Observation) -> None:
        """Check that the named bodies exist."""
        self._pair(seen)

    def pinned(self, seen: Observation) -> Met:
        """Return the condition for the same bodies by their names."""
        if not self.holds(seen):
            raise ExperimentError(f"nothing to shrink: there is no {self.text.strip()} in the run")
        return replace(self, pair=self._pair(seen))

    def holds(self, seen: Observation) -> bool:
        """Return whether the bodies met."""
        return not seen.error and (self.pair or self._pair(seen)) in seen.touches.pairs

    def said(self, seen: Observation) -> str:
        """Name the pair."""
        return f"impact of {' and '.join(sorted(self.pair or ()))}"

    def bodies(self, seen: Observation) -> set[str]:
        """Return the names of the ends that are bodies."""
        return set(self.pair or ()) & set(seen.space.names)

    def _pair(self, seen: Observation) -> Pair:
        names = Names(list(seen.space.names), names_of_solids(seen.space.scene))
        known = [*names.bodies, *names.planes]
        pair = set()
        for end in (self.first, self.second):
            if end in known:
                pair.add(end)
            elif end.isdigit() and int(end) < len(known):
                pair.add(end_name(names, int(end)))
            elif end.isdigit():
                raise ExperimentError(f"--while {self.text}: no body {end}; there are {len(names.bodies)}, from 0 on")
            else:
                near = nearest(end, known)
                hint = f'; did you mean "{near}"?' if near else ""
                raise ExperimentError(f'--while {self.text}: no body "{end}"{hint}')
        return frozenset(pair)


@dataclass(frozen=True, slots=True)
class Sunk(Condition):
    """An overlap that lasts; see `Touches`."""

    def pinned(self, seen: Observation) -> Sunk:
        """Return the condition for any pair."""
        if not self.holds(seen):
            raise ExperimentError(f"nothing to shrink: no overlap above {SUNK:.0%} of a radius lasts {LASTING} steps")
        return self

    def holds(self, seen: Observation) -> bool:
        """Return whether an overlap lasts."""
        return not seen.error and bool(seen.touches.sunk)

    def said(self, seen: Observation) -> str:
        """Name the pair that overlaps most."""
        pair, depth = max(seen.touches.sunk.items(), key=lambda one: one[1])
        return f"{' and '.join(sorted(pair))} overlap by {depth:.3g} of a radius, at rest"

    def bodies(self, seen: Observation) -> set[str]:
        """Return the bodies that overlap."""
        return {end for pair in seen.touches.sunk for end in pair} & set(seen.space.names)


@dataclass(frozen=True, slots=True)
class Warned(Condition):
    """A warning of the run."""

    kind: str = ""  # kind of the warning; empty: any kind

    def check(self, seen: Observation) -> None:
        """Check that this kind of warning exists."""
        if self.kind and self.kind not in WARNINGS:
            raise ExperimentError(f"--while {self.text}: no warning {self.kind}; {suggestion(self.kind, WARNINGS)}")

    def pinned(self, seen: Observation) -> Warned:
        """Return the condition for the same kind of warning."""
        if not self.holds(seen):
            gave = f"only {', '.join(sorted(seen.warned))}" if seen.warned else "none"
            raise ExperimentError(f"nothing to shrink: the run gave {gave} of these warnings")
        return replace(self, kind=self.kind or min(seen.warned))

    def holds(self, seen: Observation) -> bool:
        """Return whether the run gave the warning."""
        return not seen.error and (self.kind in seen.warned if self.kind else bool(seen.warned))

    def said(self, seen: Observation) -> str:
        """Name the kind."""
        return f"warning {self.kind}"

    def bodies(self, seen: Observation) -> set[str]:
        """Return the bodies where the energy was worst."""
        worst = seen.space.named_extremes().energy_error
        return {seen.space.names[body] for body in worst.bodies} if worst else set()


@dataclass(frozen=True, slots=True)
class Failed(Condition):
    """A run that ends with an error."""

    message: str = ""  # message without numbers and names of bodies; empty: any message
    stated: bool = True  # whether a PhysicsError, which states a reason, also counts as a failure
    about: str = ""  # text that the message must contain

    def pinned(self, seen: Observation) -> Failed:
        """Return the condition for the same message, with any numbers."""
        if not self.holds(seen):
            end = seen.space.scene.unit_system.text(seen.space.time, TIME)
            ended = f"ended with an error: {seen.error}" if seen.error else f"reached its end, t = {end}"
            raise ExperimentError(f"nothing to shrink: the run {ended}")
        return replace(self, message=_template(seen.error))

    def holds(self, seen: Observation) -> bool:
        """Return whether the run failed with this message."""
        if not seen.error or (seen.stated and not self.stated):
            return False
        return self.about in seen.error and self.message in ("", _template(seen.error))

    def said(self, seen: Observation) -> str:
        """Return the message."""
        return f"PhysicsError: {seen.error}" if seen.stated else seen.error

    def bodies(self, seen: Observation) -> set[str]:
        """Return the bodies named in the message."""
        numbers = {int(number) for number in re.findall(r"body (\d+)", seen.error)}
        return {name for number, name in enumerate(seen.space.names) if number in numbers}


def _template(message: str) -> str:
    """Return a message without its numbers and names of bodies."""
    return _BODIES.sub("bodies", _NUMBER.sub("N", message))
