"""Which faults does a test find? ``python benchmarks/planted_faults.py [NAME ...] [--suite]``.

Each fault is a small change of one source file: a sign, a factor, a unit, a bound, a lost term. It is planted in a copy
of the checkout, whose tests then run: those that `make check` chooses for the file, and, if they pass and ``--suite``
is given, the default tests. A fault that no test finds is a promise without a check.

Exit with 1 if `make check` misses more than `MISSED_BY_CHECK` of all faults, or the default tests miss one.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "carom"
MISSED_BY_CHECK = 10
COPIED = ("src", "tests", "configs", "benchmarks", "examples", "docs", "recordings", ".ci", ".github")
PATIENCE = 1200.0  # s for the tests of one fault; a fault that hangs them is found, too


@dataclass(frozen=True, slots=True)
class PlantedFault:
    """A fault: a text of a file below `SOURCE` and what replaces it."""

    file: str
    right: str  # stands once in the file
    wrong: str

    @property
    def name(self) -> str:
        """The module and the line, such as ``contact/coulomb:31``."""
        text = (SOURCE / self.file).read_text(encoding="utf-8")
        return f"{self.file.removesuffix('.py')}:{text[: text.index(self.right)].count(chr(10)) + 1}"


def faults_in(text: str) -> list[PlantedFault]:
    """Read faults: ``@ FILE``, ``- TEXT`` and ``+ TEXT``, a line each."""
    lines = [line for line in text.splitlines() if line.startswith(("@ ", "- ", "+ "))]
    return [PlantedFault(*(line[2:] for line in lines[k : k + 3])) for k in range(0, len(lines), 3)]


FAULTS = faults_in(Path(__file__).with_suffix(".txt").read_text(encoding="utf-8"))


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the tests found a fault, and by which test."""

    fault: PlantedFault
    found_by: str  # "check", "suite", or empty
    test: str  # the first that failed
    seconds: float


def copied(folder: Path) -> Path:
    """Copy the checkout with its compiled kernels."""
    for name in COPIED:
        shutil.copytree(ROOT / name, folder / name)
    for file in ROOT.iterdir():
        if file.is_file():
            shutil.copy2(file, folder / file.name)
    return folder


def run_tests(checkout: Path, tests: Sequence[str]) -> str:
    """Run tests up to the first failure, and return it; empty if all pass."""
    environment = os.environ | {"PYTHONPATH": str(checkout / "src"), "CAROM_SEED": "1"}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "--no-header", "-p", "no:cacheprovider", *tests]
    try:
        done = subprocess.run(
            command, cwd=checkout, env=environment, capture_output=True, text=True, check=False, timeout=PATIENCE
        )
    except subprocess.TimeoutExpired:
        return "it hangs"
    if done.returncode == 0:
        return ""
    failed = [line for line in done.stdout.splitlines() if line.startswith(("FAILED", "ERROR"))]
    return failed[0].split(" - ")[0] if failed else f"pytest exits with {done.returncode}"


def chosen_tests(checkout: Path, fault: PlantedFault) -> list[str]:
    """Return the tests that `make check` runs after a change of the file of a fault."""
    script = f"from affected import affected; print('\\n'.join(affected(['src/carom/{fault.file}'])))"
    environment = os.environ | {"PYTHONPATH": str(checkout / "tests" / "support")}
    done = subprocess.run([sys.executable, "-c", script], env=environment, capture_output=True, text=True, check=True)
    return done.stdout.split()


def judge(checkout: Path, fault: PlantedFault, suite: bool) -> Verdict:
    """Plant a fault, run the tests, and remove it."""
    path, began = checkout / "src" / "carom" / fault.file, time.monotonic()
    right = path.read_text(encoding="utf-8")
    path.write_text(right.replace(fault.right, fault.wrong), encoding="utf-8")
    try:
        test = run_tests(checkout, chosen_tests(checkout, fault))
        by = "check" if test else ""
        if not test and suite:
            test = run_tests(checkout, [])
            by = "suite" if test else ""
    finally:
        path.write_text(right, encoding="utf-8")
    return Verdict(fault, by, test, time.monotonic() - began)


def judged(faults: Sequence[PlantedFault], suite: bool) -> Iterator[Verdict]:
    """Judge faults one after the other, in one copy of the checkout."""
    with tempfile.TemporaryDirectory() as folder:
        checkout = copied(Path(folder) / "carom")
        for fault in faults:
            yield judge(checkout, fault, suite)


def main() -> None:
    """Judge the faults, and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="parts of the names of faults; default: all")
    parser.add_argument("--suite", action="store_true", help="run the default tests where those of make check pass")
    parser.add_argument("--save", type=Path, help="append each verdict to a file of JSON lines")
    given = parser.parse_args()
    faults = [fault for fault in FAULTS if not given.names or any(name in fault.name for name in given.names)]
    verdicts = list[Verdict]()
    for verdict in judged(faults, given.suite):
        verdicts.append(verdict)
        print(
            f"{verdict.found_by or 'MISSED':<7} {verdict.seconds:5.0f} s  {verdict.fault.name}  {verdict.test}",
            flush=True,
        )
        if given.save:
            with given.save.open("a", encoding="utf-8") as file:
                row = {"fault": verdict.fault.name, "found_by": verdict.found_by, "test": verdict.test}
                file.write(json.dumps(row) + "\n")
    by_check = sum(verdict.found_by == "check" for verdict in verdicts)
    missed = sum(not verdict.found_by for verdict in verdicts)
    print(f"{len(verdicts)} faults: make check finds {by_check}, the default tests {len(verdicts) - missed}")
    sys.exit(len(verdicts) - by_check > MISSED_BY_CHECK or (given.suite and missed > 0))


if __name__ == "__main__":
    main()
