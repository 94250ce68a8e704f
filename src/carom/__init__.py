"""carom: a flight recorder for colliding spheres.

scene = carom.Scene.load("configs/cloud-collapse.toml")
for frame in carom.Space(scene).run():   # physics only, no file
    ...
recording = carom.run(scene, "recordings/cloud.rrd")
recording.energy()                       # a pyarrow.Table over step and sim_time
carom.replay(recording).same             # whether it runs again with the same bits
carom.resume(recording, until=20.0)      # the same run, to a later time
carom.view(recording, at=12.0)           # Rerun's viewer, in a window
"""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING, Any

from carom.held_signals import signals_held

if TYPE_CHECKING:
    from carom import errors as errors
    from carom import record as record
    from carom.display.notebook import show as show
    from carom.display.viewer import view as view
    from carom.lab.fields.fields import fields as fields
    from carom.physics.space import Space as Space
    from carom.recording.read.recording import Recording as Recording
    from carom.runs.replay import replay as replay
    from carom.runs.resume import resume as resume
    from carom.runs.run import run as run
    from carom.runs.window import rerun as rerun
    from carom.scene.load import Scene as Scene
    from carom.state.frame import Frame as Frame

    __version__: str

__all__ = ["Frame", "Recording", "Scene", "Space", "__version__", "errors", "record"]
__all__ += ["fields", "replay", "rerun", "resume", "run", "show", "view"]

_HOMES = {
    "Frame": "carom.state.frame",
    "Recording": "carom.recording.read.recording",
    "Scene": "carom.scene.load",
    "Space": "carom.physics.space",
    "fields": "carom.lab.fields.fields",
    "replay": "carom.runs.replay",
    "rerun": "carom.runs.window",
    "resume": "carom.runs.resume",
    "run": "carom.runs.run",
    "show": "carom.display.notebook",
    "view": "carom.display.viewer",
}


def __getattr__(name: str) -> Any:
    """Import a public name on its first use, so that help does not wait for compilers and viewers."""
    if name not in __all__:
        raise AttributeError(f"module 'carom' has no attribute {name!r}")
    with signals_held():  # after an interrupt, a program such as a notebook may go on
        if name == "__version__":
            return importlib.import_module("importlib.metadata").version("carom")
        if name in ("errors", "record"):
            return importlib.import_module(f"carom.{name}")
        home = importlib.import_module(_HOMES[name])
        if arrow := sys.modules.get("pyarrow"):
            arrow.array([0])  # this imports pandas, if it is installed, like any first conversion
        return getattr(home, name)


def __dir__() -> list[str]:
    """Return all public names, used or not."""
    return __all__
