"""The limits of the method that a step may meet, as messages."""

from __future__ import annotations

from carom.physics.contact.constraint_graph import OVERFLOW
from carom.scene.schema import ContactSettings

DEEP_OVERLAP = 0.1  # of the smaller radius; rigid spheres do not overlap at all
OVERLAPS = f"Bodies overlap by more than {DEEP_OVERLAP:.0%} of the smaller radius"


def limits_of(
    contact: ContactSettings,
    *,
    serial_stage: bool,
    too_few_sweeps: bool,
    exhausted: bool,
    crossed: bool,
    deepest: float,
    at_impacts: bool,
) -> list[tuple[str, str]]:
    """Return the limits that a step met: level, `WARN` or `INFO`, and text.

    Parameters
    ----------
    contact
        The scene's section.
    serial_stage
        Whether contacts need more colours than there are parallel stages.
    too_few_sweeps
        Whether contacts still closed after the sweeps.
    exhausted
        Whether a body had so many impacts that its contacts were held.
    crossed
        Whether a body would have passed through a plane.
    deepest
        The deepest overlap over the smaller radius.
    at_impacts
        Whether impacts are resolved at their own times.
    """
    reached = []
    if serial_stage:  # this costs time only
        text = f"More than {OVERFLOW} colours are needed: the rest is resolved in a last, serial stage."
        reached.append(("INFO", text))
    if too_few_sweeps:
        reached.append(("WARN", still_closing(contact)))
    if exhausted:
        text = (
            "A body had so many impacts in one step that its last contacts were held, without a rebound; in shorter "
            "steps (time.fixed_dt, time.cfl) more of them rebound."
        )
        reached.append(("WARN", text))
    if crossed:
        longer = "" if at_impacts else ' or contact.timing = "time-of-impact"'
        text = (
            "A body would have passed through a plane within one step and was stopped where it touched the plane; "
            f"try a shorter step (time.fixed_dt, time.cfl){longer}."
        )
        reached.append(("WARN", text))
    if deepest > DEEP_OVERLAP and not contact.allow_overlap:
        more = " or more sweeps (contact.sweeps)" if contact.sweeps != "auto" else ""
        text = f"{OVERLAPS}; try a shorter step (time.fixed_dt, time.cfl){more}."
        reached.append(("WARN", text))
    return reached


def still_closing(contact: ContactSettings) -> str:
    """Return the text of too few sweeps."""
    return (
        f"Contacts were still closing after the sweeps of a step (contact.sweeps = {contact.sweeps}); "
        "what is left is resolved in later steps."
    )
