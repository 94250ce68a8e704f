"""The summary of a run without a recording, and expressions over its numbers, such as ``energy.max_error > 1e-3``.

Each node of an expression becomes a function of the summary; nothing in the text is executed.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any

import numpy as np

from carom.errors import ExperimentError, PhysicsError
from carom.event import Event
from carom.physics.space import Space
from carom.runs.environment import versions
from carom.runs.outcome import Verdict, judge
from carom.runs.run import closing_summary
from carom.scene.start import names_of_solids
from carom.scene.wording import Names, nearest
from carom.state.frame import Frame

LONGEST = 1000  # largest number of characters of an expression
_EXAMPLE = "expected a condition such as energy.max_error > 1e-3"
_WORDS: dict[str, Any] = {"true": True, "false": False, "null": None, "inf": math.inf, "nan": math.nan}
_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.In: lambda item, container: item in container,
    ast.NotIn: lambda item, container: item not in container,
}
_OPERATIONS: dict[type[ast.operator], Callable[[Any, Any], Any]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
}
_SIGNS: dict[type[ast.unaryop], Callable[[Any], Any]] = {
    ast.Not: operator.not_,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
Evaluator = Callable[[Mapping[str, Any]], Any]  # computes the value of a node from a summary
_FUNCTIONS: dict[str, Callable[..., Any]] = {"abs": abs, "min": min, "max": max, "len": len}


class UnknownNameError(Exception):
    """An expression uses a name that is not in a summary."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


class Expression:
    """A condition on a summary: comparisons of names, numbers and texts, joined by ``and``, ``or`` and ``not``.

    Names are the keys of ``carom inspect --json``, with dots between the levels. Raises ExperimentError if the text
    cannot be read.
    """

    def __init__(self, text: str, option: str = "--while") -> None:
        self.text, self.option = text, option
        self.names: list[str] = []
        try:
            if len(text) > LONGEST:
                raise ExperimentError(f"{option}: {len(text)} characters are too many; at most {LONGEST}")
            self._evaluate = self._compiled(ast.parse(text.strip(), mode="eval").body)
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ExperimentError(f"{option} {text}: {_EXAMPLE}") from None
        if not self.names:
            raise ExperimentError(f"{option} {text}: contains no quantity of a run; {_EXAMPLE}")

    def __reduce__(self) -> tuple[Any, ...]:
        """Pickle only the text; another process compiles it again."""
        return Expression, (self.text, self.option)

    def holds(self, summary: Mapping[str, Any]) -> bool:
        """Return whether the condition holds; UnknownNameError if the summary lacks a name."""
        try:
            return bool(self._evaluate(summary))
        except (TypeError, ZeroDivisionError, OverflowError):  # such as null > 1 where momentum is not conserved
            return False

    def unknown(self, summary: Mapping[str, Any]) -> list[str]:
        """Return the names that a summary does not have."""
        known = set(_leaves(summary))
        return [name for name in self.names if name not in known]

    def explain_unknown(self, name: str, summary: Mapping[str, Any]) -> str:
        """Return the message about an unknown name, with the nearest known name."""
        near = nearest(name, list(_leaves(summary)))
        hint = f'; did you mean "{near}"?' if near else ""
        return f"{self.option} {self.text}: the summary has no {name}{hint} (`carom inspect --json` prints all names)"

    def measured(self, summary: Mapping[str, Any]) -> str:
        """Describe the value of each name, for a message."""
        return ", ".join(f"{name} is {_shown(_looked_up(name, summary))}" for name in self.names)

    def _compiled(self, node: ast.expr) -> Evaluator:
        """Return the function that evaluates a node, and store the node's names; refuse nodes that are not allowed."""
        match node:
            case ast.Name() | ast.Attribute():
                name = self._dotted(node)
                if name in _WORDS:
                    return lambda summary: _WORDS[name]
                self.names += [name] if name not in self.names else []
                return lambda summary: _looked_up(name, summary)
            case ast.Constant(value=bool() | int() | float() | str() as value):
                return lambda summary: value
            case ast.List(elts=nodes) | ast.Tuple(elts=nodes):
                parts = [*map(self._compiled, nodes)]
                return lambda summary: [part(summary) for part in parts]
            case ast.BoolOp(op=op, values=nodes):
                parts, joined = [*map(self._compiled, nodes)], all if isinstance(op, ast.And) else any
                return lambda summary: joined(part(summary) for part in parts)
            case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _COMPARISONS for op in ops):
                parts, tests = [*map(self._compiled, (left, *others))], [_COMPARISONS[type(op)] for op in ops]

                def compared(summary: Mapping[str, Any]) -> bool:
                    values = [part(summary) for part in parts]
                    return all(test(*pair) for test, pair in zip(tests, pairwise(values), strict=True))

                return compared
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
                one, other, operation = self._compiled(left), self._compiled(right), _OPERATIONS[type(op)]
                return lambda summary: operation(one(summary), other(summary))
            case ast.UnaryOp(op=sign, operand=operand) if type(sign) in _SIGNS:
                one, signed = self._compiled(operand), _SIGNS[type(sign)]
                return lambda summary: signed(one(summary))
            case ast.Call(func=ast.Name(id=name), args=nodes, keywords=[]) if name in _FUNCTIONS:
                parts = [*map(self._compiled, nodes)]
                return lambda summary: _FUNCTIONS[name](*(part(summary) for part in parts))
        raise ExperimentError(f"{self.option} {self.text}: {ast.unparse(node)} is not allowed; {_EXAMPLE}")

    def _dotted(self, node: ast.expr) -> str:
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.Attribute):
            return f"{self._dotted(node.value)}.{node.attr}"
        raise ExperimentError(f"{self.option} {self.text}: {ast.unparse(node)} is not a name; {_EXAMPLE}")


def _looked_up(name: str, summary: Mapping[str, Any]) -> Any:
    node: Any = summary
    for key in name.split("."):
        if not isinstance(node, Mapping) or key not in node:
            raise UnknownNameError(name)
        node = node[key]
    return node


def _leaves(node: Mapping[str, Any], above: str = "") -> Iterator[str]:
    for key, value in node.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, f"{above}{key}.")
        else:
            yield f"{above}{key}"


def _shown(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else repr(value)


Pair = frozenset[str]  # names of both ends

SUNK = 0.05  # largest overlap that may last, relative to the smaller radius
LASTING = 20  # number of steps after which an overlap counts as lasting
STEADY = 0.01  # largest change of an overlap at rest in `LASTING` steps, relative to the smaller radius


class Touches:
    """The pairs that touched so far, identified by names, since names do not change when other bodies are left out."""

    def __init__(self, space: Space) -> None:
        self._names = Names(list(space.names), names_of_solids(space.scene))
        self._radius = space.state.radius
        self._since: dict[Pair, tuple[int, float]] = {}  # first step and depth of a steady overlap
        self.pairs: set[Pair] = set()
        self.sunk: dict[Pair, float] = {}  # overlap, relative to the smaller radius, of each pair that overlaps at rest

    def see(self, frame: Frame) -> None:
        """Add the impacts since the previous frame, and measure overlaps that last."""
        if frame.impacts is not None:
            self.pairs |= {self._pair(int(row["i"]), int(row["j"])) for row in frame.impacts}
        since, self._since = self._since, {}
        for (i, j), overlap in zip(frame.contacts.pairs, frame.contacts.overlaps, strict=True):
            depth = float(overlap / min(self._radius[i], self._radius[j] if j < len(self._radius) else np.inf))
            if depth > SUNK:
                pair = self._pair(int(i), int(j))
                step, before = since.get(pair, (frame.step, depth))
                self._since[pair] = (step, before) if abs(depth - before) <= STEADY else (frame.step, depth)
        self.sunk = {pair: depth for pair, (step, depth) in self._since.items() if frame.step - step >= LASTING}

    def _pair(self, i: int, j: int) -> Pair:
        return frozenset((end_name(self._names, i), end_name(self._names, j)))


def end_name(names: Names, end: int) -> str:
    """Return the name of a body or a plane, without its number."""
    return names.bodies[end] if end < len(names.bodies) else names.of(end)


@dataclass(eq=False)
class Observation:
    """The data of a run up to a frame."""

    space: Space
    initial: float  # J, energy at the start
    frames: int
    warnings: list[Event]
    touches: Touches
    error: str = ""  # the message of a failed run
    stated: bool = False  # whether the error is a PhysicsError, with the reason in its message

    def __post_init__(self) -> None:
        self.warned = frozenset(warning.kind for warning in self.warnings)

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """The verdicts on the promises of the scene."""
        return judge(self.space.scene, self.space.named_extremes(), self.space.time, self.space.state)

    @cached_property
    def summary(self) -> dict[str, Any]:
        """The numbers that `carom inspect --json` prints, except the numbers about the file."""
        space = self.space
        # entries are nested at the dots in their keys
        properties = closing_summary(space, space.named_extremes(), self.verdicts)
        closing: dict[str, Any] = {}
        for key, value in properties.items():
            *path, last = key.split(".")
            node = closing
            for name in path:
                node = node.setdefault(name, {})
            node[last] = value
        for moment in closing.get("moments", {}).values():
            for ends in ("bodies", "planes"):
                moment[ends] = [int(number) for number in moment[ends].split(",") if number]
        for section in ("momentum", "angular_momentum"):
            closing.setdefault(section, {"max_error": None})
        final = space.status.energy.total
        energy = {"initial": self.initial, "final": final, "max_error": 0.0} | closing.pop("energy", {})
        contacts = {"total": 0, "max_overlap": 0.0} | closing.pop("contacts", {})
        closing.pop("profile", None)
        missed = [str(verdict) for verdict in self.verdicts if not verdict.met]
        outcome = f"failed: {self.error}" if self.error else "expectation missed" if missed else "completed"
        return {
            "scene": {"title": space.scene.title},
            "bodies": len(space.state),
            "frames": self.frames,
            "outcome": outcome,
            "energy": energy,
            "contacts": contacts,
            "warnings": [{"step": w.step, "time": w.time, "text": w.text, "kind": w.kind} for w in self.warnings],
            "moments": {},
            "accuracy": {},
            "versions": versions(),
            "expect": {},
        } | closing


def said_by(error: Exception) -> str:
    """Return the message of an exception, with the type unless it is a PhysicsError."""
    return str(error) if isinstance(error, PhysicsError) else f"{type(error).__name__}: {error}"
