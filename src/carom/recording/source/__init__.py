"""Runs of other engines: the states that they expose, and the audit of these states."""
