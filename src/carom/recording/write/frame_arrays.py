"""Checks the arrays of frames before kernels read them, since compiled code does not check indices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from carom.errors import RecordingError
from carom.physics.checkpoint import Checkpoint
from carom.physics.frame import Frame
from carom.recording.schema.header import Header


def refuse_wrong_arrays(header: Header, batch: Sequence[Frame], before: Frame | Checkpoint | None) -> None:
    """Refuse frames whose arrays have other lengths than the recording has bodies, or whose contacts name no body.

    Parameters
    ----------
    before
        The frame before the first; None if there is none.

    Raises
    ------
    RecordingError
        The message names the step and the array.
    """
    n = header.bodies
    for name in ("radius", "inertia"):
        _refuse_shape(f"the recording's {name}", getattr(header, name), (n,))
    required: dict[str, tuple[int, ...]] = {"position": (n, 3), "velocity": (n, 3)}
    required |= {"orientation": (n, 4)} if header.has_orientation else {}
    required |= {"torque": (n, 3)} if header.has_torque else {}
    for frame in batch:
        graph, step = frame.contacts, f"step {frame.step}: "
        for name, shape in required.items():
            _refuse_shape(step + name, getattr(frame, name), shape)
        edges = len(graph.pairs)
        own: dict[str, tuple[int, ...]] = {
            "pairs": (edges, 2),
            "normals": (edges, 3),
            "overlaps": (edges,),
            "colours": (edges,),
        }
        for name, shape in own.items():
            _refuse_shape(f"{step}{name} of contacts", getattr(graph, name), shape)
        if graph.body_colours is not None:
            _refuse_shape(f"{step}colours of bodies", graph.body_colours, (n,))
        if edges and (graph.pairs.min() < 0 or graph.pairs[:, 0].max() >= n):  # planes and walls are second
            raise RecordingError(f"{step}a contact names no body; bodies are 0 to {n - 1}")
        if frame.impacts is not None and len(frame.impacts) and before is not None:
            _refuse_shape(f"step {before.step}, before impacts: position", before.position, (n, 3))
        before = frame


def _refuse_shape(called: str, values: Any, shape: tuple[int, ...]) -> None:
    if values is None or values.shape != shape:
        raise RecordingError(f"{called} has the shape {getattr(values, 'shape', None)} instead of {shape}")
