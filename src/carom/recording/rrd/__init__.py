"""The .rrd container format: framing, messages, index and salvage.

The package handles bytes only, independent of carom.
"""
