"""How the contacts of a run were counted, in words."""

from __future__ import annotations

EACH = "each"  # impacts on the way through a step
ONCE_A_STEP = "once a pair and step"  # impacts found at its end


def counts_text(contact_steps: int, impacts: int | None, counted: str | None) -> str:
    """Say what the two numbers are.

    Parameters
    ----------
    contact_steps
        Pairs that touched, summed over the steps.
    impacts
        Contacts that closed faster than at rest; None where nobody counted them.
    counted
        `EACH`, `ONCE_A_STEP`, or None where that is not known.
    """
    steps = f"{contact_steps} contact-steps (pairs that touch, summed over steps)"
    if impacts is None:
        return steps
    how = f" (counted {counted})" if counted not in (None, EACH) else ""
    return f"{impacts} impacts{how}, {steps}"
