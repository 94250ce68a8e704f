"""The tests of what changed: ``python tests/support/affected.py [COMMIT]`` prints them, one a line, for `make check`.

What changed are the files that differ from a commit (by default, the one at which this branch left origin/main), and
new ones. The map from a module to its tests needs no upkeep:

- its mirror, `tests/a/b/test_c.py` for `src/carom/a/b/c.py`;
- of the tests that import it, those that import the fewest other modules: they are about it, not about the whole; if
  none imports it, the tests of the modules that do;
- if it has kernels, some golden runs.

A changed module of `tests/support` has tests in the same way, and a changed test is one. `make test` runs everything.
"""

from __future__ import annotations

import ast
import re
import subprocess
import sys
from functools import cache
from pathlib import Path

ROOT = Path(__file__).parents[2]
BASES = ("src/", "tests/support/", "tests/")  # where the names of modules begin
HOME = re.compile(r"carom(\.\w+)+:\w+")  # a module and a name, as in the table of commands, which are loaded on use
MOST = 4  # tests of a module, beside its mirror
DOCS = "tests/test_names_in_docs.py"
GOLDEN = "tests/golden/test_golden.py::test_the_bits_of_a_scene_are_the_stored_ones_by_every_method"
GOLDEN_SCENES = ("golden/heap", "golden/orbits")


def affected(changed: list[str]) -> list[str]:
    """Return the tests of changed files; both are paths from the root."""
    files = {path.relative_to(ROOT).as_posix(): imports(path) for base in BASES for path in (ROOT / base).rglob("*.py")}
    tests = {name: imported for name, imported in files.items() if is_test(name)}
    chosen = {name for name in changed if name in tests}
    for name in changed:
        if name in tests or not name.startswith(BASES):
            continue
        reached, about = {name}, set[str]()
        while not about:
            modules = {module_of(each) for each in reached}
            importing = {each for each, imported in files.items() if imported & modules}
            about = importing & set(tests)
            if importing <= reached:
                break
            reached |= importing
        chosen.update(sorted(about, key=lambda test: (len(tests[test]), test))[:MOST])
        folder, _, stem = module_of(name).removeprefix("carom.").rpartition(".")
        chosen.update({f"tests/{folder.replace('.', '/')}/test_{stem}.py"} & set(tests))
        if name.startswith("src/carom/physics/") and any("jit" in each for each in imports(ROOT / name)):
            chosen.update(f"{GOLDEN}[{scene}]" for scene in GOLDEN_SCENES)
    return [*sorted(chosen), DOCS] if changed else []


def is_test(name: str) -> bool:
    """Tell whether a file has tests."""
    return name.rpartition("/")[2].startswith("test_")


def module_of(name: str) -> str:
    """Return the name by which a file is imported."""
    base = next(base for base in BASES if name.startswith(base))
    return name.removeprefix(base).removesuffix(".py").removesuffix("/__init__").replace("/", ".")


@cache
def imports(path: Path) -> frozenset[str]:
    """Return the modules that a file imports, wherever in it."""
    found = set[str]()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if path.exists() else ():
        if isinstance(node, ast.Import):
            found.update(alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            found.update([node.module, *(f"{node.module}.{alias.name}" for alias in node.names)])
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and HOME.fullmatch(node.value):
            found.add(node.value.partition(":")[0])
    return frozenset(found)


def _git(*arguments: str) -> list[str]:
    done = subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout.splitlines()


def main() -> None:
    """Print the tests of what changed."""
    since = sys.argv[1] if len(sys.argv) > 1 else _git("merge-base", "origin/main", "HEAD")[0]
    changed = {*_git("diff", "--name-only", since), *_git("ls-files", "--others", "--exclude-standard")}
    print("\n".join(affected(sorted(name for name in changed if name.endswith(".py")))))  # noqa: T201


if __name__ == "__main__":
    main()
