"""Kernels that count no references, and all that they call, make no arrays: Numba could not compile them first."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import carom.physics

PACKAGE = Path(carom.physics.__file__).parent
COUNTS_NONE = {"inner", "long_kernel"}
KERNELS = COUNTS_NONE | {"kernel", "long_kernel", "inner", "inline"}
MAKERS = {"empty", "empty_like", "zeros", "zeros_like", "ones", "full", "arange", "copy", "concatenate", "argsort"}

Name = tuple[str, str]  # module and function


class Kernel(NamedTuple):
    decorators: set[str]
    calls: set[Name]
    makes: bool


def kernels() -> dict[Name, Kernel]:
    found = {}
    for path in PACKAGE.rglob("*.py"):
        module = ".".join(("carom.physics", *path.relative_to(PACKAGE).with_suffix("").parts))
        tree = ast.parse(path.read_text(encoding="utf-8"))
        imports = {
            name.asname or name.name: (node.module, name.name)
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and node.module
            for name in node.names
        }
        for function in tree.body:
            if isinstance(function, ast.FunctionDef):
                names = [
                    each for listed in function.decorator_list for each in ast.walk(listed)
                ]  # `leading(inner)`, too
                decorators = {each.id for each in names if isinstance(each, ast.Name)} & KERNELS
                called = [call.func for call in ast.walk(function) if isinstance(call, ast.Call)]
                calls = {imports.get(each.id, (module, each.id)) for each in called if isinstance(each, ast.Name)}
                makes = any(isinstance(each, ast.Attribute) and each.attr in MAKERS for each in called)
                if decorators:
                    found[module, function.name] = Kernel(decorators, calls, makes)
    return found


def reached(start: Name, all_kernels: dict[Name, Kernel]) -> Iterator[Name]:
    """Yield a kernel and all kernels that it calls, directly or not."""
    seen, left = {start}, [start]
    while left:
        yield (name := left.pop())
        fresh = {each for each in all_kernels[name].calls if each in all_kernels} - seen
        seen |= fresh
        left += fresh


def test_kernels_that_count_no_references_call_none_that_makes_an_array() -> None:
    found = kernels()
    starts = [name for name, kernel in found.items() if kernel.decorators & COUNTS_NONE]
    assert starts
    wrong = {(start, name) for start in starts for name in reached(start, found) if found[name].makes}
    assert not wrong
