"""CI judges a commit by the same random examples each time; elsewhere every run looks for new ones."""

import os

from hypothesis import settings

settings.register_profile("ci", derandomize=True, database=None)
if os.environ.get("CI"):
    settings.load_profile("ci")
