"""Simulationarchives of REBOUND, by rebound itself."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from carom.scene.data.table import Raw, Table, refuse_many_rows
from carom.scene.error import SceneError
from carom.scene.units.rebound import units_of_rebound


def open_rebound(path: Path, called: str, snapshot: int) -> Table:
    """Open a Simulationarchive at one of its snapshots."""
    try:
        import rebound  # noqa: PLC0415 - an extra
    except ModuleNotFoundError:
        raise SceneError(
            f'{called}: a Simulationarchive needs rebound; install it with: pip install "carom[rebound]"'
        ) from None
    with warnings.catch_warnings():
        warnings.filterwarnings("error", ".*corrupted.*", RuntimeWarning)
        archive = rebound.Simulationarchive(str(path))
    count = len(archive)
    if not -count <= snapshot < count:
        raise SceneError(f"{called}: there is no snapshot {snapshot}: it has {count}")
    simulation = archive[snapshot % count]
    refuse_many_rows(called, simulation.N)
    arrays = {"position": np.zeros((simulation.N, 3)), "velocity": np.zeros((simulation.N, 3))}
    arrays |= {"mass": np.zeros(simulation.N), "radius": np.zeros(simulation.N)}
    simulation.serialize_particle_data(
        xyz=arrays["position"], vxvyvz=arrays["velocity"], m=arrays["mass"], r=arrays["radius"]
    )
    there = {name: array for name, array in arrays.items() if array.any() or name == "position"}
    return _Particles(called, there, units_of_rebound(simulation.units))


class _Particles:
    """Particles of one snapshot; a radius or mass that REBOUND has as 0 throughout is left out."""

    def __init__(self, called: str, arrays: dict[str, Raw], units: str) -> None:
        self.called = called
        self.units = units
        self._arrays = arrays
        self.names: Sequence[str] = list(arrays)

    def read(self, names: Sequence[str], texts: Sequence[str] = ()) -> dict[str, Raw]:
        """Return arrays by their names."""
        return {name: self._arrays[name] for name in names}
