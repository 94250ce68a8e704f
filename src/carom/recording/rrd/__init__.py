"""The .rrd container format: framing, messages, index and salvage. Bytes only; knows nothing of carom."""
