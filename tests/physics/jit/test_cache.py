"""Compiled kernels on disk: used if they are whole and up to date, else compiled anew; in folders of the user alone."""

from __future__ import annotations

import ast
import ctypes
import json
import os
import random
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import carom
from carom.physics.jit import cache
from carom.physics.jit.cache import CHECKSUM, imports_of

WATCHED = ("portable_math.py", "rest_speed.py")  # modules of `carom.scene` with constants and functions of kernels

COUNT = 8
KERNELS = "from carom.physics.jit.decorators import kernel\nfrom pack.part import {part}\n" + "".join(
    f"@kernel\ndef f{k}(x: float) -> float:\n    return {{part}}(x) + {k}.0\n" for k in range(COUNT)
)
PART = (
    "from carom.physics.jit.decorators import inner\n@inner\ndef {part}(x: float) -> float:\n    return {factor} * x\n"
)
CALL = f"""
import json
from carom.physics.jit.decorators import Compilations, cache_folder
from pack import kernels
with Compilations() as compilations:
    values = [getattr(kernels, f"f{{k}}")(1.0) for k in range({COUNT})]
print(json.dumps([values, compilations.count, cache_folder()]))
"""


INTERRUPTED = """
import json
import signal
from numba.core.codegen import JITCodeLibrary

load, pending = JITCodeLibrary._object_getbuffer_hook, []
def interrupt(module):
    while pending:
        signal.raise_signal(pending.pop())
    return load(module)
JITCodeLibrary._object_getbuffer_hook = interrupt  # LLVM's callback for code from disk
from pack import kernels
kernels.f1(1.0)  # also loads code of Numba's own
pending.append(signal.SIGINT)
try:
    kernels.f0(1.0)
except KeyboardInterrupt:
    print(json.dumps([[kernels.f0(1.0)], 0, "interrupted"]))
"""


@pytest.fixture
def package(tmp_path: Path) -> Path:
    """A package of kernels that call one in another file, and a folder for what is compiled of it."""
    folder = tmp_path / "pack"
    folder.mkdir()
    (folder / "__init__.py").touch()
    (folder / "kernels.py").write_text(KERNELS.format(part="part"), encoding="utf-8")
    (folder / "part.py").write_text(PART.format(part="part", factor=2.0), encoding="utf-8")
    return folder


def call(package: Path, **options: Any) -> tuple[list[float], int, str]:
    """Call the kernels in a process of their own: what they return, how many were compiled, and where they are kept."""
    environment = {"NUMBA_CACHE_DIR": str(package.parent / "cache")} | options.pop("env", {})
    called = subprocess.run(
        [sys.executable, "-c", options.pop("program", CALL)],
        env=os.environ | {"PYTHONPATH": str(package.parent)} | environment,
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
        **options,
    )
    assert called.returncode == 0, called.stderr
    values, compiled, folder = json.loads(called.stdout)
    return values, compiled, folder


@pytest.mark.slow
def test_an_interrupt_while_a_kernel_is_loaded_from_disk_is_raised_and_the_kernel_works(package: Path) -> None:
    call(package)
    assert call(package, program=INTERRUPTED) == ([2.0], 0, "interrupted")


@pytest.mark.slow
def test_processes_that_start_together_compile_each_kernel_once(package: Path) -> None:
    with ThreadPoolExecutor(2) as pool:
        answers = list(pool.map(lambda _: call(package), range(2)))
    assert [values for values, _, _ in answers] == [[2.0 + k for k in range(COUNT)]] * 2
    assert sum(compiled for _, compiled, _ in answers) == COUNT + 1


def test_a_kernel_that_a_killed_process_had_begun_is_compiled_by_another(tmp_path: Path) -> None:
    kernel = tmp_path / "kernel.nbc"
    claim = f"""
import pathlib, sys
from carom.physics.jit import cache
print(cache._claim(pathlib.Path({str(kernel)!r})), flush=True)
sys.stdin.read()
"""
    with subprocess.Popen([sys.executable, "-c", claim], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline() == b"True\n"
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(cache, "PATIENCE", 0.1)
            assert not cache._claim(kernel), "while the other process has it"
        other.kill()
        other.wait()
        assert cache._claim(kernel)
    cache._release(kernel)


def damage(rng: random.Random, files: list[Path]) -> None:
    """Change every file but the last in one of the ways in which files are found damaged."""
    contents = [file.read_bytes() for file in files]
    for k, file in enumerate(files[:-1]):
        content = contents[k]
        at = rng.randrange(len(content))
        flipped = content[:at] + bytes([content[at] ^ 1 << rng.randrange(8)]) + content[at + 1 :]
        ways = [
            b"",
            content[:at],
            flipped,
            contents[k + 1],  # another kernel's, whole in itself
            content + b"\0",
            content[: rng.randrange(2 * CHECKSUM)],
            rng.randbytes(len(content)),
        ]
        file.write_bytes(ways[k % len(ways)])


@pytest.mark.slow
def test_damaged_and_exchanged_files_are_compiled_anew(package: Path, seed: int) -> None:
    expected = [2.0 + k for k in range(COUNT)]
    assert call(package)[:2] == (expected, COUNT + 1)
    assert call(package)[:2] == (expected, 0)
    files = sorted((package.parent / "cache").rglob("kernels.f*.nbc"))
    assert len(files) == COUNT
    damage(random.Random(seed), files)
    values, compiled, _ = call(package)
    assert values == expected and compiled >= COUNT - 1, f"seed {seed}"
    assert call(package)[:2] == (expected, 0)


@pytest.mark.slow
def test_a_kernel_is_compiled_anew_when_one_that_it_calls_has_changed_in_another_file(package: Path) -> None:
    assert call(package)[1] == COUNT + 1
    (package / "part.py").write_text(PART.format(part="part", factor=3.0), encoding="utf-8")
    assert call(package)[:2] == ([3.0 + k for k in range(COUNT)], COUNT + 1)
    (package / "other.py").write_text("x = 1\n", encoding="utf-8")
    assert call(package)[1] == 0


@pytest.mark.slow
def test_files_of_a_kernel_that_has_moved_or_changed_do_not_heap_up(package: Path) -> None:
    call(package)
    moved = "# each kernel is a line further\n" + KERNELS.format(part="part")
    (package / "kernels.py").write_text(moved, encoding="utf-8")
    assert call(package)[1] == COUNT
    files = sorted((package.parent / "cache").rglob("*.nbc"))
    assert len(files) == COUNT + 1
    call(package, env={"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""})
    assert set(files) < set((package.parent / "cache").rglob("*.nbc")), "those of another processor stay"


BASELINE = {"NUMBA_CPU_NAME": cache.BASELINE, "NUMBA_CPU_FEATURES": ""}


@pytest.mark.slow
@pytest.mark.skipif(not cache._is_baseline_met(), reason="this processor lacks features of the baseline")
def test_kernels_that_a_wheel_carries_for_the_baseline_are_used_where_nobody_has_chosen_a_processor(
    package: Path,
) -> None:
    expected = [2.0 + k for k in range(COUNT)]
    assert call(package, env={"NUMBA_CACHE_DIR": ""} | BASELINE)[1] == COUNT + 1, "beside the sources, as in a wheel"
    assert call(package)[:2] == (expected, 0), "used, though the cache of this machine is another folder"
    assert call(package, env={"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""})[1] == COUNT + 1
    file = next((package / "__pycache__").glob("kernels.f0-*.nbc"))
    file.write_bytes(file.read_bytes()[:-1])
    assert call(package)[:2] == (expected, 1), "the damaged one is compiled anew"


RECORD = "from typing import NamedTuple\nclass Ball(NamedTuple):\n    {first}: float\n    {second}: float\n"
HEAVIER = (
    "from carom.physics.jit.decorators import kernel\n@kernel\n"
    "def doubled(ball) -> float:\n    return 2.0 * ball.mass\n"
)


def doubled(package: Path, home: str) -> float:
    """Call a kernel with a named tuple that is defined in a module which the kernel's own module does not import."""
    call = f"from pack import heavier, {home}; print(heavier.doubled({home}.Ball(mass=3.0, radius=1.0)))"
    called = subprocess.run(
        [sys.executable, "-c", call],
        env=os.environ | {"PYTHONPATH": str(package.parent), "NUMBA_CACHE_DIR": str(package.parent / "cache")},
        cwd="/",
        capture_output=True,
        text=True,
        check=False,
    )
    assert called.returncode == 0, called.stderr
    return float(called.stdout)


@pytest.mark.slow
def test_a_kernel_is_compiled_anew_when_a_named_tuple_that_it_takes_was_moved_or_reordered(package: Path) -> None:
    (package / "heavier.py").write_text(HEAVIER, encoding="utf-8")
    (package / "old.py").write_text(RECORD.format(first="mass", second="radius"), encoding="utf-8")
    assert doubled(package, "old") == 6.0
    (package / "old.py").write_text(RECORD.format(first="radius", second="mass"), encoding="utf-8")
    assert doubled(package, "old") == 6.0, "the order of the fields"
    (package / "old.py").rename(package / "new.py")
    assert doubled(package, "new") == 6.0, "the module"


@pytest.mark.slow
def test_the_quick_search_finds_the_imports_that_python_finds() -> None:
    """The search for imports is a quick one, by patterns: compare it with Python's own parser, for every file."""
    root = Path(carom.__file__).parent
    for file in root.rglob("*.py"):
        parsed = ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        names = set()
        for node in parsed:
            if isinstance(node, ast.Import):
                names |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{file}: a relative import is not followed"
                members = {f"{node.module}.{alias.name}" for alias in node.names}
                names |= members if all(is_module(root, name) for name in members) else {str(node.module), *members}
        paths = [root.joinpath(*name.split(".")[1:]) for name in names if name.split(".")[0] == "carom"]
        files = {path.with_suffix(".py") for path in paths} | {path / "__init__.py" for path in paths}
        assert {path for path in files if path.is_file()} <= set(imports_of(file, "carom")), file


def is_module(root: Path, name: str) -> bool:
    """Return whether a dotted name is a module or package of carom."""
    path = root.joinpath(*name.split(".")[1:])
    return path.with_suffix(".py").is_file() or (path / "__init__.py").is_file()


DECORATORS = {"kernel", "long_kernel", "inline", "inner", "instruction", "chosen_by_type"}


def test_kernels_use_nothing_of_carom_but_the_modules_that_their_cache_watches() -> None:
    """Else a kernel would stay as it was compiled, although a constant in it has changed."""
    root = Path(carom.__file__).parent
    for file in (root / "physics").rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        unwatched = {
            alias.asname or alias.name
            for node in ast.walk(tree)
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("carom")
            for alias in node.names
            if not any(cache._may_be_compiled(path) for path in files_of(root, f"{node.module}.{alias.name}"))
        }
        compiled: list[ast.AST] = [
            node.value for node in tree.body if isinstance(node, ast.Assign | ast.AnnAssign) and node.value
        ]
        for node in ast.walk(tree):
            if isinstance(node, ast.FunctionDef) and DECORATORS & {
                each.id for part in node.decorator_list for each in ast.walk(part) if isinstance(each, ast.Name)
            }:
                compiled += node.body
        used = {each.id for part in compiled for each in ast.walk(part) if isinstance(each, ast.Name)}
        # the names of the fields of a record belong to the type of an argument; no kernel has a graph
        assert used & unwatched <= {"Coefficients", "empty_graph"}, f"{file}: {used & unwatched}"


def files_of(root: Path, name: str) -> list[Path]:
    """Return the file that defines a name of a module of carom, and that of the module of this name, if it exists."""
    module, path = root.joinpath(*name.split(".")[1:-1]), root.joinpath(*name.split(".")[1:])
    files = [path.with_suffix(".py"), path / "__init__.py", module.with_suffix(".py"), module / "__init__.py"]
    return [file for file in files if file.is_file()][:1]


def test_a_kernel_of_contacts_does_not_depend_on_the_scene_or_the_registry(monkeypatch: pytest.MonkeyPatch) -> None:
    """Else each changed message there compiles every kernel again, for minutes."""
    read: set[Path] = set()
    original = cache._checksum

    def noted(file: Path) -> bytes:
        read.add(file)
        return original(file)

    monkeypatch.setattr(cache, "_checksum", noted)
    root = Path(carom.__file__).parent
    file = root / "physics" / "contact" / "solver" / "solve.py"
    cache.sources_of.__wrapped__("carom.physics.contact.solver.solve", file)
    assert file in read
    assert not [path for path in read if path.is_relative_to(root / "scene") and path.name not in WATCHED]
    assert not read & {root / "__init__.py", root / "registry.py", root / "physics" / "contact" / "pipeline.py"}


def test_the_kernel_of_few_bodies_depends_on_all_stages_that_are_compiled_into_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its stages for contacts, drag and planes are chosen by the types of arguments; no call names their modules."""
    read: set[str] = set()
    original = cache._checksum

    def noted(file: Path) -> bytes:
        read.add(file.relative_to(Path(carom.__file__).parent).as_posix())
        return original(file)

    monkeypatch.setattr(cache, "_checksum", noted)
    cache.sources_of.__wrapped__("carom.physics.few_bodies", Path(carom.__file__).parent / "physics" / "few_bodies.py")
    stages = "steady_contacts", "steady_data", "event_loop", "trajectories"
    assert {f"physics/contact/events/{name}.py" for name in stages} | {"physics/forces/drag.py"} <= read


@pytest.fixture
def root(tmp_path: Path) -> Path:
    """A folder as the system's temporary one is: open to all, sticky."""
    folder = tmp_path / "temporary"
    folder.mkdir()
    folder.chmod(0o1777)
    return folder


def test_a_folder_of_the_user_alone_is_made_and_used_again(root: Path) -> None:
    assert cache._is_own(root / "mine") and cache._is_own(root / "mine")
    assert (root / "mine").stat().st_mode & 0o777 == 0o700


def test_a_folder_that_others_can_write_to_or_that_lies_elsewhere_is_not_used(root: Path) -> None:
    (root / "open").mkdir()
    (root / "open").chmod(0o757)
    (root / "elsewhere").mkdir(mode=0o700)
    (root / "link").symlink_to(root / "elsewhere")
    (root / "file").touch(mode=0o700)
    assert not any(cache._is_own(root / name) for name in ("open", "link", "file"))
    root.chmod(0o777)  # without the sticky bit, anybody can put another folder in its place
    assert not cache._is_own(root / "mine")


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give a folder to another user")
def test_a_folder_of_another_user_is_not_used(root: Path) -> None:
    for name in ("theirs", "above/below", "group"):
        (root / name).mkdir(mode=0o700, parents=True)
    os.chown(root / "theirs", 65534, 65534)
    os.chown(root / "above", 65534, 65534)
    os.chown(root / "group", -1, 65534)
    (root / "group").chmod(0o770)
    assert not any(cache._is_own(root / name) for name in ("theirs", "above/below", "group"))


@pytest.mark.parametrize(
    "fault",
    [
        "open to others",
        *(pytest.param(each, marks=pytest.mark.slow) for each in ("of another user", "below a folder open to others")),
    ],
)
def test_a_cache_folder_that_is_not_the_users_own_is_not_used_though_it_was_asked_for(
    package: Path, tmp_path: Path, fault: str
) -> None:
    """What lies there is unpickled and linked. The kernels are kept beside the sources in place of it."""
    if fault == "of another user" and os.geteuid() != 0:
        pytest.skip("only root can give a folder to another user")
    asked = tmp_path / "asked" / "cache"
    asked.mkdir(parents=True)
    if fault == "of another user":
        os.chown(asked, 65534, 65534)
    else:
        (asked if fault == "open to others" else asked.parent).chmod(0o777)
    _, compiled, kept = call(package, env={"NUMBA_CACHE_DIR": str(asked)})
    assert compiled and Path(kept) == Path(cache.__file__).parents[1] / "__pycache__"
    assert not any(asked.iterdir()) and list((package / "__pycache__").glob("*.nbc"))


@pytest.fixture
def read_only(package: Path) -> Iterator[dict[str, Any]]:
    """Options for `call`: an installation that cannot be written to, a user without a home, a planted folder."""
    shutil.copytree(Path(carom.__file__).parent, package.parent / "carom", ignore=shutil.ignore_patterns("__pycache__"))
    temporary = package.parent / "temporary"
    planted = temporary / f"carom-kernels-{os.getuid()}"
    planted.mkdir(parents=True)
    installed = [Path(folder) for top in (package, package.parent / "carom") for folder, _, _ in os.walk(top)]
    for folder in installed:
        folder.chmod(0o555)
    temporary.chmod(0o1777)
    planted.chmod(0o777)
    environment = {"HOME": "/proc/none", "XDG_CACHE_HOME": "", "NUMBA_CACHE_DIR": "", "TMPDIR": str(temporary)}
    yield {"env": environment, "preexec_fn": obey_permissions}
    for folder in installed:
        folder.chmod(0o755)


def obey_permissions() -> None:
    """Let even root write only where it is allowed to."""
    drop, right_to_write_anywhere = 24, 1  # PR_CAPBSET_DROP, CAP_DAC_OVERRIDE
    if os.geteuid() == 0:
        ctypes.CDLL(None).prctl(drop, right_to_write_anywhere, 0, 0, 0)


def test_without_a_folder_of_its_own_a_kernel_is_compiled_each_time_and_nothing_planted_is_used(
    package: Path, read_only: dict[str, Any]
) -> None:
    assert call(package, **read_only) == ([2.0 + k for k in range(COUNT)], COUNT + 1, "")
    assert not list(package.parent.rglob("*.nbc"))
