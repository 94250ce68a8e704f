"""The counts of contacts and impacts of a run and its deepest overlap, in words."""

from __future__ import annotations

from carom.contact_table import ROUNDED_OVERLAP
from carom.scene.wording import counted

EACH = "each"  # impacts during the drift of a step
ONCE_A_STEP = "once a pair and step"  # impacts found at its end


def counts_text(contact_steps: int, impacts: int | None, each: str | None, summed_over: str = "steps") -> str:
    """Describe the two numbers.

    Parameters
    ----------
    contact_steps
        Pairs that touched, summed over the steps, or over the recorded frames.
    impacts
        Contacts that closed faster than the rest speed; None if they were not counted.
    each
        How impacts were counted: `EACH`, `ONCE_A_STEP`, or None if unknown.
    summed_over
        "steps", or "frames" where nothing but the frames is known, as in a clip.
    """
    if summed_over == "frames":
        return (
            f"{counted(contact_steps, 'contact')} in the recorded frames (pairs that touch, summed over these frames)"
        )
    steps = f"{counted(contact_steps, 'contact-step')} (pairs that touch, summed over steps)"
    if impacts is None:
        return steps
    how = f" (counted {each})" if each not in (None, EACH) else ""
    return f"{counted(impacts, 'impact')}{how}, {steps}"


def overlap_text(deepest: float) -> str:
    """Describe the deepest overlap over the smaller radius; empty where nothing overlapped but by rounding."""
    return f"deepest overlap {100.0 * deepest:.3g}% of the smaller radius" if deepest > ROUNDED_OVERLAP else ""
