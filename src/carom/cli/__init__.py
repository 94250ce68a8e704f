"""The commands: options in, one call of lab, runs or show, text out."""
