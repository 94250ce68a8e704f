"""GSD files of HOOMD-blue, read by the package gsd."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from carom.errors import SceneError
from carom.install import install_extra
from carom.scene.data import (
    Arrays,
    DataFormat,
    DataTable,
    Raw,
    periodic_note,
    refuse_bomb,
    refuse_many_rows,
    step_at,
)

_CHUNKS = ("position", "velocity", "mass", "diameter", "angmom", "moment_inertia", "typeid", "charge", "orientation")


def open_gsd(path: Path, called: str, snapshot: int) -> DataTable:
    """Open a GSD file at one of its frames.

    HOOMD omits data equal to the first frame's, and defaults: a mass or a diameter of 1, which the scene must state.
    """
    try:
        from gsd import fl  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise SceneError(f"{called}: GSD needs gsd: {install_extra('gsd')}") from None
    with fl.open(str(path), "r") as file:
        frames = int(file.nframes)
        if file.schema != "hoomd":
            raise SceneError(f'{called}: a GSD file of the schema "{file.schema[:40]}"; "hoomd" is needed')
        frame = step_at(called, snapshot, frames)

        def chunk(name: str) -> Any:
            which = next((each for each in (frame, 0) if file.chunk_exists(each, name)), None)
            return None if which is None else np.asarray(file.read_chunk(which, name))

        count = chunk("particles/N")
        if count is None:
            raise SceneError(f"{called}: frame {frame} has no particles")
        refuse_many_rows(called, int(count[0]))
        refuse_bomb(called, 12 * int(count[0]), path.stat().st_size)
        arrays: dict[str, Raw] = {
            name: values for name in _CHUNKS if (values := chunk(f"particles/{name}")) is not None
        }
        box, step = chunk("configuration/box"), chunk("configuration/step")
    table = Arrays(arrays, called)
    table.notes = (
        f"{called}: frame {frame} of HOOMD, step {0 if step is None else int(step[0])}, in single precision",
        *(() if box is None else (periodic_note(called, box[:3].tolist()),)),
    )
    return table


GSD = DataFormat("a GSD file", open_gsd)
