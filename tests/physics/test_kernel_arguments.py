"""Arguments of kernels: records and named tuples carry what belongs together."""

from __future__ import annotations

import ast
from pathlib import Path

import carom

MOST = 8
DECORATORS = {"inline", "inner", "instruction", "kernel", "leading", "long_kernel"}


def arguments_of_kernels() -> dict[str, list[str]]:
    """Return the names of the arguments of each kernel of the physics."""
    root = Path(carom.__file__).parent / "physics"
    found = {}
    for file in sorted(root.rglob("*.py")):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.FunctionDef) and _decorators(node) & DECORATORS:
                names = [argument.arg for argument in (*node.args.posonlyargs, *node.args.args, *node.args.kwonlyargs)]
                found[f"{file.relative_to(root)}:{node.name}"] = names[1:] if names[:1] == ["code"] else names
    return found


def _decorators(function: ast.FunctionDef) -> set[str]:
    """Return the names of decorators, such as ``inner`` of ``@leading(inner)``."""
    return {
        name.id for decorator in function.decorator_list for name in ast.walk(decorator) if isinstance(name, ast.Name)
    }


def test_no_kernel_takes_more_than_eight_arguments() -> None:
    kernels = arguments_of_kernels()
    assert len(kernels) > 300  # the search finds them
    assert {name: len(own) for name, own in kernels.items() if len(own) > MOST} == {}
