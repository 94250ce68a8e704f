"""The exact state of a run, float64, as it is kept in a recording: enough to go on from, bit for bit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from carom.physics.energy import Energy, Ledger
from carom.physics.frame import Frame

FloatArray = NDArray[np.float64]

_VECTORS = ("position", "velocity", "acceleration", "angular_velocity")
_ENERGIES = ("translational", "rotational", "gravitational", "field", "integration_error", "scale")
_LEDGER = ("restitution", "friction", "stabilisation")


@dataclass(frozen=True, slots=True)
class StoredState:
    """A checkpoint read back. Arrays are float64, exactly as they were."""

    step: int
    time: float  # s
    previous_dt: float  # s
    position: FloatArray  # (n, 3) m
    velocity: FloatArray  # (n, 3) m/s
    acceleration: FloatArray  # (n, 3) m/s²
    orientation: FloatArray | None  # (n, 4) xyzw
    angular_velocity: FloatArray | None  # (n, 3) rad/s
    energy: Energy  # J


def size(bodies: int, spins: bool) -> int:
    """Bytes that one checkpoint takes."""
    return 8 * (bodies * (16 if spins else 9) + 2 + len(_ENERGIES) + len(_LEDGER))


def encode(frames: Sequence[Frame]) -> dict[str, FloatArray]:
    """Flatten frames into one array per component, frame after frame."""
    arrays = {
        "position": [frame.position for frame in frames],
        "velocity": [frame.velocity for frame in frames],
        "acceleration": [frame.checkpoint.acceleration for frame in frames],
        "orientation": [frame.orientation for frame in frames if frame.orientation is not None],
        "angular_velocity": [frame.angular_velocity for frame in frames if frame.angular_velocity is not None],
    }
    encoded = {name: np.concatenate(parts).ravel() for name, parts in arrays.items() if parts}
    encoded["time"] = np.array([frame.time for frame in frames])
    encoded["previous_dt"] = np.array([frame.checkpoint.previous_dt for frame in frames])
    for name in _ENERGIES:
        encoded[f"energy_{name}"] = np.array([float(getattr(frame.energy, name)) for frame in frames])
    for name in _LEDGER:
        encoded[f"ledger_{name}"] = np.array([float(getattr(frame.energy.ledger, name)) for frame in frames])
    return encoded


def decode(step: int, stored: Mapping[str, FloatArray]) -> StoredState:
    """Undo :func:`encode` for one frame."""
    vectors = {name: stored[name].reshape(-1, 3) for name in _VECTORS if name in stored}
    ledger = Ledger(**{name: float(stored[f"ledger_{name}"][0]) for name in _LEDGER})
    energies = {name: float(stored[f"energy_{name}"][0]) for name in _ENERGIES}
    orientation = stored.get("orientation")
    return StoredState(
        step=step,
        time=float(stored["time"][0]),
        previous_dt=float(stored["previous_dt"][0]),
        position=vectors["position"],
        velocity=vectors["velocity"],
        acceleration=vectors["acceleration"],
        orientation=None if orientation is None else orientation.reshape(-1, 4),
        angular_velocity=vectors.get("angular_velocity"),
        energy=Energy(ledger=ledger, **energies),
    )


class CheckpointPlan:
    """Decides which frames carry a checkpoint, so that checkpoints take about a tenth of the recording.

    Frame 0 always carries one, and so does a frame with a warning, until warnings alone have used up another tenth.
    """

    _SHARE = 0.1
    _WARNINGS_AT_LEAST = 4

    def __init__(self, size: int) -> None:
        self._size = size
        self._regular = 0
        self._warned = 0

    def chosen(self, batch: Sequence[Frame], bytes_before: int, bytes_of_batch: int) -> list[Frame]:
        """Choose the frames to keep, when the recording has so many bytes before the batch, and the batch so many."""
        others = bytes_before - (self._regular + self._warned) * self._size
        kept = []
        for index, frame in enumerate(batch):
            room = self._SHARE * (others + bytes_of_batch * (index + 1) / len(batch))
            if frame.step == 0 or (self._regular + 1) * self._size <= room:
                self._regular += 1
                kept.append(frame)
            elif _warns(frame) and (self._warned < self._WARNINGS_AT_LEAST or (self._warned + 1) * self._size <= room):
                self._warned += 1
                kept.append(frame)
        return kept


def _warns(frame: Frame) -> bool:
    return any(event.level == "WARN" for event in frame.events)
