"""The end of a run in words."""

from __future__ import annotations

from collections.abc import Mapping

from carom.scene.units.dimension import RATE, TIME
from carom.scene.units.system import UnitSystem

_DISK = "disk"
_FAILED = "recording failed"


def in_words(outcome: str) -> str:
    """Describe a status, with its reason if there is one; ``disk`` means that the recording could not be written."""
    return _FAILED + outcome.removeprefix(_DISK) if outcome == _DISK or outcome.startswith(f"{_DISK}:") else outcome


def error_text(error: float) -> str:
    """Return a relative error with three digits, or 0."""
    return f"{error:.2e}" if error else "0"


def accuracy_text(accuracy: Mapping[str, float], units: UnitSystem) -> str:
    """Say whether a run kept its accuracy; for the keys see `carom.runs.run.kept_accuracy`."""
    until = f"up to t = {units.text(accuracy['horizon'], TIME)} only" if "horizon" in accuracy else "to the end"
    if "looked" in accuracy:
        until += f" (the budget of the look ahead ended at t = {units.text(accuracy['looked'], TIME)})"
    per = f" /{units.unit(TIME)}" if units.unit(TIME) else ""
    exponent = f"largest Lyapunov exponent over that time {units.shown(accuracy['lyapunov'], RATE):.3g}{per}"
    return f"{accuracy['requested']:g} kept {until}; {exponent}"
