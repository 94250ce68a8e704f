"""Every file, module, symbol, scene key and command that the docs and docstrings name exists."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterator
from fnmatch import fnmatch
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from typing import Any, get_args

import pytest
from pydantic import BaseModel
from typer.main import get_command

from carom.cli.main import app
from carom.cli.stress import extremes
from carom.scene.load import Scene
from carom.scene.scene_file import bundled_scenes
from carom.scene.scene_model import know_installed_parts

know_installed_parts()  # otherwise known once a scene is read
ROOT = Path(__file__).parents[1]
PACKAGE = ROOT / "src" / "carom"
CODE = [path for folder in ("src", "tests", "benchmarks") for path in sorted((ROOT / folder).rglob("*.py"))]
PAGES = [ROOT / "README.md", ROOT / "SECURITY.md", *ROOT.glob("CONTRIBUTING.md"), *sorted((ROOT / "docs").glob("*.md"))]
FOLDERS = {"benchmarks", "configs", "docs", "src", "tests"}
LINE = 120  # characters of a line of code, and of a row that is read at a glance
COMMANDS: dict[str, Any] = get_command(app).commands  # type: ignore[attr-defined]
EVERYWHERE = {"--help", "--version", "--install-completion", "--show-completion"}

PATH = re.compile(r"[\w.*-]+(/[\w.*-]+)*(\.py|/)|[\w.-]+(/[\w.*-]+)+\.\w+|[\w-]+\.md")
DOTTED = re.compile(r"[A-Za-z_]\w*(\.[A-Za-z_]\w*)+")
NAME = re.compile(r"_?[A-Z]+[a-z]+[A-Z]\w*|[A-Z]\w*|_?[a-z]+\w*_\w*|[A-Z][A-Z\d]*_[A-Z\d_]+")  # CamelCase, snake_case
ASSIGNED = re.compile(r"(?P<key>[a-z_]+\.[a-z_]+(\.[a-z_]+)*) ?=")
SECTION = re.compile(r"\[{1,2}([a-z_]+)\]{1,2}")
COMMAND = re.compile(r"carom ([a-z]+)\b(.*)")
PLACEHOLDER = re.compile(r"\b[A-Z]+\b(?=\.py)")
FLAG = re.compile(r"(?<!\S)--[a-z][a-z-]+")


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.needs("distributed") if page.name == "sweeps.md" else ()) for page in PAGES],
    ids=lambda path: path.name,
)
def test_a_page_names_only_what_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert not list(unknown_spans(spans_of_markdown(text), page)) and not list(broken_links(text, page))


def test_a_concept_has_one_line_that_says_where_it_is() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = page.partition("## Where is …?")[2].partition("\n## ")[0].splitlines()
    assert not [row for row in rows if len(row) > LINE], "split it into two concepts"


def test_reading_paths_are_short() -> None:
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    rows = page.partition("## Reading paths")[2].partition("\n\nA step")[0].splitlines()[4:]
    step, frame, why = rows[:3], rows[3:4], rows[4:]
    counts = [sum(len(re.findall(r"\w+\.py`", row)) for row in part) for part in (step, frame, why)]
    assert counts == [10, 7, 5], "what counts is the length of the reading path"


@pytest.mark.parametrize("page", PAGES, ids=lambda path: path.name)
def test_a_page_shows_only_commands_that_exist(page: Path) -> None:
    shown = re.findall(r"```sh\n(.*?)```", page.read_text(encoding="utf-8"), flags=re.DOTALL)
    lines = [line for block in shown for line in block.splitlines()]
    found = [(line, COMMAND.fullmatch(part)) for line in lines for part in re.split(r" (?:&&|\|) ", line)]
    assert not [line for line, command in found if command and not is_command(*command.groups())]


def test_docstrings_name_only_what_exists() -> None:
    unknown = []
    for path in CODE:
        if path.is_relative_to(PACKAGE):
            spans = [span for text in docstrings(path) for span in re.findall(r"`+([^`\n]+)`+", text)]
            named = [span for text in docstrings(path) for span in re.findall(r"(?<!`)`(\w+)`(?!`)", text)]
            missing = [*unknown_spans(spans, path), *(name for name in named if name not in words())]
            unknown += [f"{path.relative_to(ROOT)}: {span}" for span in missing]
    assert not unknown


@pytest.mark.parametrize(
    "span",
    [
        "contact/no_such_file.py",
        "docs/no-such-page.md",
        "carom.physics.no_such_module",
        "physics.no_such_module",
        "Space.no_such_method",
        "NoSuchClass",
        "no_such_name_anywhere",
        "contact.no_such_key",
        'contact.no_such_key = "staged"',
        "[no_such_section]",
        "carom nosuchcommand",
        "carom run --no-such-flag",
        "--no-such-flag",
    ],
)
def test_the_check_notices_a_name_that_does_not_exist(span: str) -> None:
    assert list(unknown_spans([span], ROOT / "README.md"))


def unknown_spans(spans: Iterator[str] | list[str], near: Path) -> Iterator[str]:
    """Return the code spans that name something in carom that is not there; what names nothing is left alone."""
    return (span for span in spans if not is_known(span.strip(), near))


def is_known(span: str, near: Path) -> bool:
    if command := COMMAND.fullmatch(span):
        return is_command(*command.groups())
    if section := SECTION.fullmatch(span):
        return section[1] in Scene.model_fields
    if assigned := ASSIGNED.match(span):
        return assigned["key"].partition(".")[0] not in Scene.model_fields or is_scene_key(assigned["key"])
    if span.startswith("--"):
        return all(
            flag in EVERYWHERE or any(flag in options(command) for command in COMMANDS.values())
            for flag in FLAG.findall(span)
        )
    if PATH.fullmatch(span):
        return is_path(span, near)
    if DOTTED.fullmatch(called := span.removesuffix("()")):
        return is_dotted(called, near)
    return not NAME.fullmatch(called) or called.lstrip("_") in words() or called in words() or is_composed(called)


def is_path(span: str, near: Path) -> bool:
    """Tell whether a file or folder is there: from the root, from the page, or somewhere as the end of a path."""
    span = PLACEHOLDER.sub("*", span)
    first = span.partition("/")[0]
    if not span.endswith((".py", ".md")) and first not in FOLDERS and not (PACKAGE / first).exists():
        return True  # what carom writes
    ending = "/" + span.rstrip("/")
    near_it = (near.parent / span.rstrip("/")).exists()
    return near_it or any(fnmatch(f"/{known}", f"*{ending}") for known in paths())


def is_dotted(span: str, near: Path) -> bool:
    first, *rest = span.split(".")
    if first in Scene.model_fields and is_scene_key(span):
        return True
    if first == "carom":
        return resolves(span)
    if (PACKAGE / first).is_dir():
        return resolves(f"carom.{span}") or span in strings()
    if first in attributes():
        return all(name in words() for name in rest) if len(rest) > 1 else has_attribute(first, rest[0])
    if first in modules():
        return any(resolves(f"{module}.{'.'.join(rest)}") for module in modules()[first]) or is_composed(span)
    return all(name in words() for name in (first, *rest)) or find_spec(first) is not None  # of another package


def is_composed(name: str) -> bool:
    """Tell whether the code composes a name, as in ``f"ledger_{entry}"``."""
    starts = (text for text in strings() if text.endswith(("_", ".")) and name.startswith(text))
    return name in strings() or any(name.removeprefix(start) in words() for start in starts)


def is_scene_key(key: str) -> bool:
    model: type[BaseModel] | None = Scene
    for name in key.split("."):
        if model is None or name not in keys(model):
            return False
        model = next(iter(models_in(model.model_fields[name].annotation)), None) if name in model.model_fields else None
    return True


def keys(model: type[BaseModel]) -> set[str]:
    return {*model.model_fields, *(str(field.alias) for field in model.model_fields.values() if field.alias)}


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from models_in(part)


def is_command(name: str, rest: str) -> bool:
    return name in COMMANDS and all(flag in EVERYWHERE | options(COMMANDS[name]) for flag in FLAG.findall(rest))


def options(command: Any) -> set[str]:
    return {name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)}


def resolves(dotted: str) -> bool:
    """Tell whether a dotted name from ``carom`` on is a module, something in one, or something in a class of one."""
    parts = dotted.split(".")
    for length in range(len(parts), 0, -1):
        stem = PACKAGE.parent.joinpath(*parts[:length])
        for file in (stem.with_suffix(".py"), stem / "__init__.py"):
            if file.exists():
                rest = parts[length:]
                if not rest or (len(rest) == 1 and rest[0] in defined_in(file)):
                    return True
                return len(rest) == 2 and rest[0] in defined_in(file) and has_attribute(*rest)
    return False


def defined_in(file: Path) -> set[str]:
    """Return what a module defines or imports."""
    nodes = list(ast.walk(trees()[file]))
    names = {node.name for node in nodes if isinstance(node, (ast.ClassDef, ast.FunctionDef))}
    names |= {node.id for node in nodes if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store)}
    return names | {node.asname or node.name for node in nodes if isinstance(node, ast.alias)}


@cache
def paths() -> set[str]:
    """Return the files and folders of the repository, from its root."""
    found = [path for folder in FOLDERS for path in (ROOT / folder, *(ROOT / folder).rglob("*"))]
    return {str(path.relative_to(ROOT)) for path in [*found, *ROOT.glob("*")] if path.name != "__pycache__"}


@cache
def trees() -> dict[Path, ast.Module]:
    return {path: ast.parse(path.read_text(encoding="utf-8")) for path in CODE if path != Path(__file__)}


@cache
def nodes(path: Path) -> list[ast.AST]:
    """Every node of a file; three of the lists below need all of them."""
    return list(ast.walk(trees()[path]))


@cache
def docstring_nodes(path: Path) -> list[ast.Constant]:
    with_body = (ast.Module, ast.ClassDef, ast.FunctionDef)
    bodies = (node.body for node in nodes(path) if isinstance(node, with_body))
    firsts = (body[0].value for body in bodies if body and isinstance(body[0], ast.Expr))
    return [first for first in firsts if isinstance(first, ast.Constant) and isinstance(first.value, str)]


def docstrings(path: Path) -> list[str]:
    return [str(node.value) for node in docstring_nodes(path)]


@cache
def strings() -> set[str]:
    """The texts in the code that are not docstrings."""
    found = set()
    for path in trees():
        docs = {id(node) for node in docstring_nodes(path)}
        for node in nodes(path):
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in docs:
                found.add(node.value)
            elif isinstance(node, ast.Constant) and isinstance(node.value, bytes):
                found.add(node.value.decode("latin-1"))
    return found


@cache
def words() -> set[str]:
    """Every identifier in the code, and every word in its texts: keys, values, columns."""
    found = {*dir(builtins), *modules(), *(path.stem for path in CODE)}
    for text in strings():
        found.update(re.findall(r"\w+", text))
    for path in trees():
        for node in nodes(path):
            for field in ("id", "attr", "arg", "name", "asname"):
                if isinstance(name := getattr(node, field, None), str):
                    found.update(name.split("."))
    return found


@cache
def modules() -> dict[str, list[str]]:
    """The modules and packages of carom by their last names."""
    found: dict[str, list[str]] = {}
    for path in PACKAGE.rglob("*.py"):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        parts = parts[:-1] if parts[-1] == "__init__" else parts
        found.setdefault(parts[-1], []).append(".".join(parts))
    return found


@cache
def attributes() -> dict[str, set[str]]:
    """The members that the classes of carom define, and their bases, in ``bases:NAME``."""
    found: dict[str, set[str]] = {}
    for path in CODE:
        for node in nodes(path) if path.is_relative_to(PACKAGE) else ():
            if isinstance(node, ast.ClassDef):
                own = found.setdefault(node.name, set())
                own.update(f"bases:{base.id}" for base in node.bases if isinstance(base, ast.Name))
                for part in ast.walk(node):
                    if isinstance(part, ast.FunctionDef):
                        own.add(part.name)
                    elif isinstance(part, ast.Name) and isinstance(part.ctx, ast.Store):
                        own.add(part.id)
                    elif isinstance(part, ast.Attribute) and getattr(part.value, "id", "") == "self":
                        own.add(part.attr)
    return found


def has_attribute(name: str, attribute: str) -> bool:
    own = attributes().get(name, set())
    bases = [entry.removeprefix("bases:") for entry in own if entry.startswith("bases:")]
    return attribute in own or any(has_attribute(base, attribute) for base in bases)


def spans_of_markdown(text: str) -> list[str]:
    without_blocks = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    return re.findall(r"`([^`\n]+)`", without_blocks)


def broken_links(text: str, page: Path) -> Iterator[str]:
    """Return the links to files and to headings of this repository that lead nowhere."""
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if "://" not in target:
            path, _, heading = target.partition("#")
            file = page.parent / path if path else page
            if not file.exists() or (heading and heading not in headings(file)):
                yield target


def headings(page: Path) -> set[str]:
    lines = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", line.lower()).strip().replace(" ", "-") for line in lines}


def test_the_bodies_that_the_page_of_recordings_asks_for_are_in_its_scene() -> None:
    text = (ROOT / "docs" / "recording.md").read_text(encoding="utf-8")
    asked = re.findall(r'^recording\.(?:trajectory|impacts)\(.*?"(\w+)"', text, re.MULTILINE)
    names = {body.name for body in Scene.load("two-spheres").body}
    assert asked and set(asked) <= names


def test_the_readme_and_the_changelog_count_the_scenes_that_carom_has() -> None:
    assert (len(bundled_scenes()), len(extremes())) == (24, 37), "change the phrases below, too"
    for page, phrases in {
        "README.md": ("twenty-four scenes", "37 scenes at the limits", "37 extreme scenes"),
        "CHANGELOG.md": ("twenty-four bundled", "37 numerical extremes"),
    }.items():
        text = " ".join((ROOT / page).read_text(encoding="utf-8").split())
        assert not [phrase for phrase in phrases if phrase not in text]
