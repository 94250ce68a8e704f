"""Settings of all tests.

In a fresh clone the processes of a test run would compile the same kernels, one waiting for the other: a process of its
own begins with the last ones, as beside the first run on a machine.

A worker of pytest-xdist runs whole files, by default those with the most tests first. Files with a few long tests would
then come last, and leave all workers but one without work: here they come first.

What tests draw at random, and the examples of Hypothesis, are the same in every run, so that no commit fails by chance.
CAROM_SEED=random tries new examples. The report of a test that failed has its seed.

With all tests in memory, Python's search for garbage took an eighth of a compilation: here it searches seldom.

PYTHONDONTWRITEBYTECODE is set in many containers. Each process of a test run would rewrite all of Hypothesis and of the
tests for pytest, and each command that a test starts would compile the sources of carom: we keep byte code anyway.

A shell that starts us in the background has us ignore the interrupt key, and `nohup` the end of the terminal. The
programs that tests start and then interrupt would inherit both.
"""

import gc
import os
import signal
import sys
from collections import Counter
from collections.abc import Generator

import pytest

from carom.physics.jit import cores
from carom.terminal.compilation import start_on_a_new_installation
from cloud_run import cloud_file, cloud_run  # noqa: F401 - fixtures
from needs import missing_though_required, need
from other_processor import other_processor  # noqa: F401 - a fixture
from seeds import VARIABLE, chosen_seed, is_random

LONG_FILES = (  # those that take half a minute of CPU time or more, kernels included, by this time
    *("test_plain.py", "test_warmup.py", "test_random_packing.py", "test_moving_walls.py", "test_hopper_flow.py"),
    *("test_removable.py", "test_extension.py", "test_sheared_gas.py", "test_translating_walls.py", "test_replay.py"),
    *("test_granular_gas.py", "test_chute_flow.py", "test_changing_motion.py"),
)
SEED = chosen_seed()

gc.set_threshold(100_000)
sys.dont_write_bytecode = False
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)

for number, usual in ((signal.SIGINT, signal.default_int_handler), (signal.SIGHUP, signal.SIG_DFL)):
    if signal.getsignal(number) == signal.SIG_IGN:
        signal.signal(number, usual)


def pytest_configure(config: pytest.Config) -> None:
    """End at once where a package that CAROM_REQUIRE requires is missing: modules of tests are skipped without it.

    Otherwise set what Hypothesis draws, and keep pytest-xdist (from 3.8 on) to the order of the files here.
    """
    config.option.loadscopereorder = False
    if missing := missing_though_required():
        raise pytest.UsageError(f"CAROM_REQUIRE: {', '.join(missing)}: not installed; pip install '.[full]'")
    from hypothesis import settings  # not before byte code is kept

    settings.register_profile("same", deadline=None, derandomize=True, database=None)
    settings.register_profile("new", deadline=None, print_blob=True)
    settings.load_profile("new" if is_random() else "same")


def pytest_report_header() -> str:
    return f"{VARIABLE}={SEED}"


def pytest_xdist_auto_num_workers() -> int:
    """Return one process more than there are cores: tests wait for two fifths of their time, for what they start."""
    return cores() + 1


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Sort the files in the processes of pytest-xdist, after tests have been deselected."""
    if hasattr(config, "workerinput"):
        tests = Counter(item.path for item in items)
        rank = {name: rank for rank, name in enumerate(LONG_FILES)}
        items.sort(key=lambda item: (rank.get(item.path.name, len(rank)), -tests[item.path], item.path))


@pytest.hookimpl(tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> None:
    """Skip a test that needs what this machine does not have, before its fixtures are set up."""
    for mark in item.iter_markers("needs"):
        for what in mark.args:
            need(what)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item, call: pytest.CallInfo[None]
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Say how to repeat a test that failed with what it drew."""
    report = yield
    if report.failed and "seed" in getattr(item, "fixturenames", ()):
        report.sections.append(("seed", f"{VARIABLE}={SEED} repeats this"))
    return report


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile kernels beside the first tests, if there are none yet and several processes will need them."""
    if not hasattr(session.config, "workerinput") and session.config.getoption("numprocesses", 0):
        start_on_a_new_installation()


@pytest.fixture
def seed() -> int:
    """The seed of this run, for tests that draw at random."""
    return SEED
