"""Expressions over the numbers of a summary, such as ``energy.max_error > 1e-3 and bodies < 5``.

An expression is parsed into a tree and evaluated node by node; nothing in it is executed.
"""

from __future__ import annotations

import ast
import math
import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from carom.errors import ExperimentError
from carom.scene.wording import nearest

LONGEST = 1000  # characters
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
_FUNCTIONS: dict[str, Callable[..., Any]] = {"abs": abs, "min": min, "max": max, "len": len}


class UnknownNameError(Exception):
    """A summary does not have a name that an expression uses."""

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.name = name


class Expression:
    """A condition on a summary.

    Parameters
    ----------
    text
        Comparisons of names, numbers and texts, joined by ``and``, ``or`` and ``not``. Names are the keys of
        ``carom inspect --json``, with dots between the levels.

    Raises
    ------
    ExperimentError
        If it cannot be read.
    """

    def __init__(self, text: str, option: str = "--while") -> None:
        self.text, self.option = text, option
        try:
            if len(text) > LONGEST:
                raise ExperimentError(f"{option}: {len(text)} characters are too many; at most {LONGEST}")
            self._tree = ast.parse(text.strip(), mode="eval").body
        except (SyntaxError, ValueError, RecursionError, MemoryError):
            raise ExperimentError(f"{option} {text}: {_EXAMPLE}") from None
        self.names = list(dict.fromkeys(self._names(self._tree)))
        if not self.names:
            raise ExperimentError(f"{option} {text}: it names nothing of a run; {_EXAMPLE}")

    def holds(self, summary: Mapping[str, Any]) -> bool:
        """Tell whether the condition holds.

        Raises
        ------
        UnknownNameError
            If the summary lacks a name.
        """
        try:
            return bool(self._value(self._tree, summary))
        except (TypeError, ZeroDivisionError, OverflowError):  # such as null > 1: momentum is not conserved
            return False

    def unknown(self, summary: Mapping[str, Any]) -> list[str]:
        """Return the names that a summary does not have."""
        known = set(_leaves(summary))
        return [name for name in self.names if name not in known]

    def explain_unknown(self, name: str, summary: Mapping[str, Any]) -> str:
        """Say that a summary has no such name, and which one is nearest."""
        near = nearest(name, list(_leaves(summary)))
        hint = f'; did you mean "{near}"?' if near else ""
        return f"{self.option} {self.text}: the summary has no {name}{hint} (`carom inspect --json` prints all names)"

    def measured(self, summary: Mapping[str, Any]) -> str:
        """Say what the summary has under each name, for a message."""
        return ", ".join(f"{name} is {_shown(_looked_up(name, summary))}" for name in self.names)

    def _names(self, node: ast.expr) -> Iterator[str]:
        """Yield all names; refuse every node that is not part of a condition."""
        match node:
            case ast.Name() | ast.Attribute():
                name = self._dotted(node)
                if name not in _WORDS:
                    yield name
                return
            case ast.Constant(value=bool() | int() | float() | str()):
                return
            case ast.List(elts=parts) | ast.Tuple(elts=parts) | ast.BoolOp(values=parts):
                pass
            case ast.Compare(left=left, ops=ops, comparators=others) if all(type(op) in _COMPARISONS for op in ops):
                parts = [left, *others]
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATIONS:
                parts = [left, right]
            case ast.UnaryOp(op=sign, operand=operand) if type(sign) in _SIGNS:
                parts = [operand]
            case ast.Call(func=ast.Name(id=function), args=parts, keywords=[]) if function in _FUNCTIONS:
                pass
            case _:
                raise ExperimentError(f"{self.option} {self.text}: {ast.unparse(node)} is not allowed; {_EXAMPLE}")
        for part in parts:
            yield from self._names(part)

    def _dotted(self, node: ast.expr) -> str:
        if isinstance(node, ast.Name):
            return node.id
        if isinstance(node, ast.Attribute):
            return f"{self._dotted(node.value)}.{node.attr}"
        raise ExperimentError(f"{self.option} {self.text}: {ast.unparse(node)} is not a name; {_EXAMPLE}")

    def _value(self, node: ast.expr, summary: Mapping[str, Any]) -> Any:
        match node:
            case ast.Name() | ast.Attribute():
                name = self._dotted(node)
                return _WORDS[name] if name in _WORDS else _looked_up(name, summary)
            case ast.Constant(value=value):
                return value
            case ast.List(elts=parts) | ast.Tuple(elts=parts):
                return [self._value(part, summary) for part in parts]
            case ast.BoolOp(op=ast.And(), values=parts):
                return all(self._value(part, summary) for part in parts)
            case ast.BoolOp(values=parts):
                return any(self._value(part, summary) for part in parts)
            case ast.Compare(left=left, ops=ops, comparators=others):
                values = [self._value(part, summary) for part in (left, *others)]
                pairs = zip(values, ops, values[1:], strict=False)
                return all(_COMPARISONS[type(op)](one, other) for one, op, other in pairs)
            case ast.BinOp(left=left, op=op, right=right):
                return _OPERATIONS[type(op)](self._value(left, summary), self._value(right, summary))
            case ast.UnaryOp(op=sign, operand=operand):
                return _SIGNS[type(sign)](self._value(operand, summary))
            case ast.Call(func=ast.Name(id=function), args=parts):
                return _FUNCTIONS[function](*(self._value(part, summary) for part in parts))
        raise AssertionError(f"{ast.dump(node)} was let through")


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
