"""What holds for all tests.

In a fresh clone the processes of a test run would compile the same kernels, one waiting for the other: a process of its
own begins with the last ones, as beside the first run on a machine.

CI judges a commit by the same examples of Hypothesis each time; elsewhere every run looks for new ones. Tests that
damage files or write scenes at random take a new seed in every run, in CI, too: the report begins with it, and
CAROM_TEST_SEED sets it. A shell that starts us in the background has us ignore the interrupt key, and with us the
programs that tests start and then interrupt.
"""

import os
import random
import signal
from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import settings

settings.register_profile("ci", derandomize=True, database=None)
if os.environ.get("CI"):
    settings.load_profile("ci")

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

SEED = os.environ.setdefault("CAROM_TEST_SEED", str(random.randrange(2**32)))  # processes of pytest-xdist inherit it


def pytest_report_header() -> str:
    return f"CAROM_TEST_SEED={SEED}"


def pytest_sessionstart(session: pytest.Session) -> None:
    """Compile kernels beside the first tests, if there are none yet and several processes will need them."""
    leads = not hasattr(session.config, "workerinput") and session.config.getoption("numprocesses", 0)
    carom = find_spec("carom")
    if leads and carom and carom.origin and not any(Path(carom.origin).parent.rglob("*.nbc")):
        from carom.experiment.compile_ahead import start_compiling  # noqa: PLC0415 - slow to import

        start_compiling()


@pytest.fixture
def seed() -> int:
    """The seed of this run, for tests that draw at random."""
    return int(SEED)
