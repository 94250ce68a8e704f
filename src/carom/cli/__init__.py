"""The commands: parse, call experiment, print. No logic of their own."""
