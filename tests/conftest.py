"""What holds for all tests.

CI judges a commit by the same examples of Hypothesis each time; elsewhere every run looks for new ones. Tests that
damage files or write scenes at random take a new seed in every run, in CI, too: the report begins with it, and
CAROM_TEST_SEED sets it. A shell that starts us in the background has us ignore the interrupt key, and with us the
programs that tests start and then interrupt.
"""

import os
import random
import signal

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


@pytest.fixture
def seed() -> int:
    """The seed of this run, for tests that draw at random."""
    return int(SEED)
