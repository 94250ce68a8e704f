"""Rerun's catalogue of many recordings: a table of their properties, with a link in each row that opens the recording.

Needs `carom[catalog]`.
"""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from urllib.parse import urlsplit

import datafusion  # noqa: F401 - Rerun's client needs it, and would fail only at the first request
from rerun.server import Server

from carom.display import keeper
from carom.display.keeper import Door
from carom.display.viewer import Viewer
from carom.errors import RecordingError

_HOST = "127.0.0.1"  # address of the server; by default Rerun listens on all interfaces, without a password


@contextlib.contextmanager
def catalog(name: str, paths: Sequence[Path]) -> Iterator[str]:
    """Serve recordings as a dataset on this machine; yield the address of its table.

    Each row opens with the layout of the first recording, since runs of one scene have the same layout.
    """
    missing = [path for path in paths if not path.is_file()]
    if missing or not paths:
        raise RecordingError(f"there is no recording at {missing[0]}" if missing else f"{name}: no recordings yet")
    with Server(host=_HOST, datasets={name: list(paths)}) as server:
        dataset = server.client().get_dataset(name)
        dataset.register_blueprint(f"file://{paths[0].resolve()}")
        yield f"{server.url()}/dataset/{dataset.id}"


def serve_catalog(name: str, paths: Sequence[Path], say: Callable[[str], None], alone: bool, door: Door | None) -> None:
    """Open the table in a viewer; without a screen, serve it until the interrupt key.

    Parameters
    ----------
    name, paths
        The dataset and its recordings.
    say
        Prints a line.
    alone
        Whether this process is in a network namespace of its own, so that no other viewer can reach the server.
    door
        For an isolated process without a screen: the port of the machine through which the user reaches the server.

    Raises
    ------
    RecordingError
        If a recording is missing or, for an isolated process with a screen, there is no viewer.
    """
    with catalog(name, paths) as address:
        if door is not None:
            inner = urlsplit(address)
            outer = inner._replace(netloc=f"{_HOST}:{door.address[1]}").geturl()
            say(f"{len(paths)} recordings at {outer}, for your own viewers on this machine. Ctrl-C ends it.")
            _until_interrupted(lambda: door.serve(inner.port or 0))
            return
        say(f"{len(paths)} recordings" + ("" if alone else f" at {address}"))
        try:
            with Viewer(keep=(keeper.SHARED,)) as viewer:
                viewer.open(address)
                say("A click on a row's link opens its recording. Close the window to end.")
                viewer.wait()
        except RecordingError as error:
            if alone:
                raise
            say(f"{error}. Open the address in another viewer on this machine; Ctrl-C ends this command.")
            _until_interrupted(lambda: time.sleep(1.0))


def _until_interrupted(wait: Callable[[], None]) -> None:
    with contextlib.suppress(KeyboardInterrupt):
        while True:
            wait()
