"""The .rrd container format: framing, messages, index and salvage.

The package handles only bytes, and depends on no other part of carom.
"""
