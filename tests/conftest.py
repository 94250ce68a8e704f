"""What holds for all tests.

CI judges a commit by the same random examples each time; elsewhere every run looks for new ones. A shell that starts us
in the background has us ignore the interrupt key, and with us the programs that tests start and then interrupt.
"""

import os
import signal

from hypothesis import settings

settings.register_profile("ci", derandomize=True, database=None)
if os.environ.get("CI"):
    settings.load_profile("ci")

if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
