"""The friction of a resting contact in an iteration: the law, and contacts that may not stick again."""

from __future__ import annotations

from typing import Any

from carom.physics.contact.law import lasting_friction, sliding_friction, sticks
from carom.physics.jit.decorators import inline


@inline
def friction(
    state: Any, material: Any, keeps_sliding: bool, normal: float, tx: float, ty: float, tz: float
) -> tuple[float, ...]:
    """Return the tangential impulse that a contact exerts, (3,) N s.

    Parameters
    ----------
    state, material
        `CONTACT_STATE` and `MATERIAL` of the contact; ``slides`` is noted in ``state``.
    keeps_sliding
        Whether a contact that has slid once keeps sliding, see `solver.phases`.
    normal
        N s, total of the normal impulse since the kick.
    tx, ty, tz
        N s, total of the tangential impulse that would end the slip.
    """
    if keeps_sliding and (state.slides or not sticks(material, normal, tx, ty, tz)):
        state.slides = True
        return sliding_friction(material, normal, tx, ty, tz)
    return lasting_friction(material, normal, tx, ty, tz)
