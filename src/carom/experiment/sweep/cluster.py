"""Workers of a sweep: own processes on this machine, or the user's Dask cluster. Needs `carom[cluster]`."""

from __future__ import annotations

import contextlib
import logging
import re
import socket
from collections.abc import Iterator
from typing import Any

import dask
from distributed import Client, LocalCluster
from distributed.security import Security

from carom.experiment.error import ExperimentError
from carom.experiment.sweep.task import unfit
from carom.physics.parallel.cores import cores

_LOOPBACK = "127.0.0.1"
_CONNECT = 20.0  # s
_ADDRESS = re.compile(r"\w+://\[?([^/\]]+)\]?:(\d+)/?")
_LOCAL_SETTINGS: dict[str, list[str]] = {  # any user of this machine can send HTTP requests, so nothing is served
    "distributed.scheduler.http.routes": [],
    "distributed.worker.http.routes": [],
}
_PRELOAD = "carom.experiment.sweep.preload"
_LOGGERS = ("distributed", "distributed.client", "distributed.gc", "tornado.application")
_SETTINGS = {
    "distributed.worker.memory.target": False,  # Dask does not manage the memory of runs
    "distributed.worker.memory.spill": False,
    "distributed.worker.memory.pause": False,
    "distributed.worker.memory.terminate": False,
    "distributed.comm.timeouts.connect": f"{_CONNECT:.0f}s",
    # Dask's own profiling, and its self-monitoring 50 times a second, took a sixth of two cores
    "distributed.worker.profile.enabled": False,
    "distributed.admin.tick.interval": "500ms",
    "distributed.admin.system-monitor.interval": "5s",
    "distributed.scheduler.active-memory-manager.start": False,
}


@contextlib.contextmanager
def connected(address: str | None, workers: int | None, runs: int) -> Iterator[Client]:
    """Connect to the user's scheduler, or start workers here and end them afterwards.

    Parameters
    ----------
    address
        Such as ``tcp://10.0.0.1:8786``; None starts a cluster on this machine.
    workers
        Processes to start here, one run at a time in each; by default one a core.
    runs
        Number of runs to make; no more processes are started.

    Raises
    ------
    ExperimentError
        If no scheduler answers at the address.
    """
    for logger in _LOGGERS:
        logging.getLogger(logger).setLevel(logging.CRITICAL)  # the command itself reports what happens
    with dask.config.set(_SETTINGS), contextlib.ExitStack() as stack:
        if address is None:
            stack.enter_context(dask.config.set(_LOCAL_SETTINGS))
            cluster: Any = stack.enter_context(_local_cluster(min(workers or cores(), runs)))
            yield stack.enter_context(Client(cluster, set_as_default=False))  # type: ignore[no-untyped-call]
        else:
            yield stack.enter_context(_client_of(address))


def refuse_unfit(client: Client, root: str, scene: str, version: str) -> None:
    """Refuse a cluster if some workers see another folder or have another version of carom.

    Raises
    ------
    ExperimentError
        Naming the worker.
    """
    try:
        answers = client.run(unfit, root, scene, version, on_error="return")
    except Exception as error:
        raise ExperimentError(f"the workers do not answer: {type(error).__name__}: {error}") from None
    for worker, answer in answers.items():
        if isinstance(answer, BaseException):
            raise ExperimentError(
                f"worker {worker}: {type(answer).__name__}: {answer}; it needs carom in its environment"
            )
        if answer:
            raise ExperimentError(f"worker {worker} {answer}")


def _local_cluster(workers: int) -> LocalCluster:
    """Start workers that use TLS with a key of this sweep, because loopback ports are open to all users."""
    return LocalCluster(  # type: ignore[no-untyped-call]
        n_workers=workers,
        threads_per_worker=1,
        processes=True,
        host=_LOOPBACK,
        security=_key(),
        scheduler_kwargs={"dashboard": False, "dashboard_address": f"{_LOOPBACK}:0"},  # its port may be another sweep's
        memory_limit=0,
        silence_logs=logging.CRITICAL,
        preload=[_PRELOAD],
    )


def _key() -> Security:
    try:
        return Security.temporary()  # type: ignore[no-untyped-call, no-any-return]
    except ImportError:
        raise ExperimentError(
            "workers on this machine need cryptography, for the key by which they talk; install it with: pip install "
            '"carom[cluster]"'
        ) from None


def _client_of(address: str) -> Client:
    """Connect to a scheduler; test the port first, since a client without a scheduler takes 40 s to close."""
    matched = _ADDRESS.fullmatch(address)
    if matched is None:
        raise ExperimentError(f"--cluster {address}: expected the address of a Dask scheduler, as tcp://10.0.0.1:8786")
    try:
        socket.create_connection((matched[1], int(matched[2])), _CONNECT).close()
        return Client(address, set_as_default=False, timeout=_CONNECT)  # type: ignore[no-untyped-call]
    except (OSError, OverflowError) as error:
        raise ExperimentError(f"--cluster {address}: no Dask scheduler answers: {error}") from None
