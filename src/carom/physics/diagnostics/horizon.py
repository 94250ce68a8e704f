"""The event that a run no longer keeps its accuracy."""

from __future__ import annotations

import math

from carom.event import Event
from carom.scene.schema import Scene
from carom.scene.units.dimension import TIME


def end_of_promise(scene: Scene, step: int, time: float) -> Event:
    """Return the event that the accuracy of a scene is no longer kept."""
    promise = scene.promise
    assert promise is not None
    units = scene.unit_system
    text = f"The accuracy of {scene.time.accuracy:g} is kept up to t = {units.text(promise.kept_until, TIME)}."
    if promise.horizon is not None and promise.lyapunov > 0.0:
        text += f" Small errors grow tenfold in {units.text(math.log(10.0) / promise.lyapunov, TIME, '.3g')}."
    return Event(step, time, "INFO", text, "horizon")
