"""The end of a run in words."""

from __future__ import annotations

from collections.abc import Mapping

_DISK = "disk"
_FAILED = "recording failed"


def in_words(outcome: str) -> str:
    """Describe a status, with its reason if there is one; ``disk`` means that the recording could not be written."""
    return _FAILED + outcome.removeprefix(_DISK) if outcome == _DISK or outcome.startswith(f"{_DISK}:") else outcome


def accuracy_text(accuracy: Mapping[str, float]) -> str:
    """Say whether a run kept its accuracy; for the keys see `carom.experiment.run.kept_accuracy`."""
    until = f"up to t = {accuracy['horizon']:.6g} s only" if "horizon" in accuracy else "to the end"
    exponent = f"largest Lyapunov exponent over that time {accuracy['lyapunov']:.3g} / s"
    return f"{accuracy['requested']:g} kept {until}; {exponent}"
