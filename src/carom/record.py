"""Record runs of other engines.

import carom
with carom.record.Recorder(carom.record.mujoco(model, data), "run.rrd") as recorder:
    while data.time < 10.0:
        mujoco.mj_step(model, data)
        recorder.frame()

Any object with a `Model` and a method ``state`` that returns a `State` is a `Source`. See docs/other-engines.md. The
code is in `carom.engines`, an optional folder.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from carom import registry

if TYPE_CHECKING:
    from carom.engines.adapters.box3d import box3d
    from carom.engines.adapters.mujoco import mujoco
    from carom.engines.adapters.newton import newton
    from carom.engines.adapters.pybullet import pybullet
    from carom.engines.adapters.rebound import rebound
    from carom.engines.engine_recorder import Recorder
    from carom.engines.faults import Fault, Tolerances
    from carom.engines.source import CONTACT, Model, Plane, Source, State, StateMemory

__all__ = [
    "CONTACT",
    "Fault",
    "Model",
    "Plane",
    "Recorder",
    "Source",
    "State",
    "StateMemory",
    "Tolerances",
    "box3d",
    "mujoco",
    "newton",
    "pybullet",
    "rebound",
]

_HOMES = {
    "Recorder": "carom.engines.engine_recorder",
    **dict.fromkeys(("Fault", "Tolerances"), "carom.engines.faults"),
    **dict.fromkeys(("CONTACT", "Model", "Plane", "Source", "State", "StateMemory"), "carom.engines.source"),
}


def __getattr__(name: str) -> Any:
    """Import a name, or the recorder of an engine, at its first use."""
    if name.startswith("_"):
        raise AttributeError(f"module 'carom.record' has no attribute {name!r}")
    try:
        if name in _HOMES:
            return registry.imported(f"{_HOMES[name]}:{name}")
        return registry.load("engine_records", name)
    except registry.ExtensionError as error:
        raise AttributeError(f"carom.record.{name}: {error}") from None


def __dir__() -> list[str]:
    """Return all names, used or not."""
    return __all__
