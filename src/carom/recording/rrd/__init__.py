"""The .rrd container format: framing, messages, index and salvage.

The package handles only bytes, and does not depend on the rest of carom.
"""
