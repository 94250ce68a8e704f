"""The .rrd container format: framing, messages, index and salvage. Handles bytes only, independent of carom."""
