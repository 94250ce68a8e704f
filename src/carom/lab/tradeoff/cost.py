"""The cost of a setting: the time of one run."""

from __future__ import annotations

import time

from carom.lab.engines.engine import engine_called
from carom.lab.tradeoff.settings_grid import Setting
from carom.physics.look_ahead.find_step import with_promise
from carom.physics.parallel.cores import cores
from carom.physics.schedule import at
from carom.physics.space import Space
from carom.scene.schema import Scene


def cost_of(setting: Setting, scene: Scene, threads: int | None) -> float:
    """Run a setting of a scene once without recording; return the time it took in s, with that of a look ahead.

    On one thread that is CPU time, which other programs on the machine hardly change.
    """
    if setting.engine:
        return engine_called(setting.engine).run(scene, setting)
    threads = setting.threads or threads or cores()
    clock = time.thread_time if threads == 1 else time.perf_counter
    asked = setting.apply(scene)
    began = clock()
    settled_scene = with_promise(asked, threads)
    ahead = clock() - began
    space = Space(settled_scene, threads)
    began = clock()
    for _ in space.run(schedule=at(())):
        pass
    return ahead + clock() - began
