"""Record runs of other engines.

import carom
with carom.record.Recorder(carom.record.mujoco(model, data), "run.rrd") as recorder:
    while data.time < 10.0:
        mujoco.mj_step(model, data)
        recorder.frame()

Any object with a `Model` and a method ``state`` that returns a `State` is a `Source`. See docs/other-engines.md.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from carom import registry
from carom.recording.source import Model, Plane, Source, State, StateMemory
from carom.recording.source.engine_contacts import CONTACT
from carom.recording.source.law_audit import Fault, Tolerances
from carom.runs.engine_recorder import Recorder

if TYPE_CHECKING:
    from carom.lab.engines.box3d import box3d
    from carom.lab.engines.mujoco import mujoco
    from carom.lab.engines.newton import newton
    from carom.lab.engines.pybullet import pybullet
    from carom.lab.engines.rebound import rebound

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


def __getattr__(name: str) -> Any:
    """Import the recorder of an engine at its first use."""
    if name.startswith("_"):
        raise AttributeError(f"module 'carom.record' has no attribute {name!r}")
    try:
        return registry.load("engine_records", name)
    except registry.ExtensionError as error:
        raise AttributeError(f"carom.record.{name}: {error}") from None
