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
from carom.recording.source.law_audit import Fault, Tolerances
from carom.recording.source.source import Model, Plane, Source, State
from carom.runs.engine_recorder import Recorder

if TYPE_CHECKING:
    from carom.recording.source.adapters.box3d_source import box3d
    from carom.recording.source.adapters.mujoco_source import mujoco
    from carom.recording.source.adapters.newton_source import newton
    from carom.recording.source.adapters.pybullet_source import pybullet
    from carom.recording.source.adapters.rebound_source import rebound

__all__ = [
    "Fault",
    "Model",
    "Plane",
    "Recorder",
    "Source",
    "State",
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
