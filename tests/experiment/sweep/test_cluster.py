"""Workers on this machine take orders from the sweep that started them, and from nobody else."""

from __future__ import annotations

import socket
import sys
from typing import Any

import psutil
import pytest
from distributed import Client
from distributed.security import Security

from carom.experiment.error import ExperimentError
from carom.experiment.sweep.cluster import connected


def listening() -> list[int]:
    """The ports on which this process and those it started listen."""
    here = psutil.Process()
    sockets = [socket for process in (here, *here.children(recursive=True)) for socket in process.net_connections()]
    assert {socket.laddr.ip for socket in sockets if socket.status == psutil.CONN_LISTEN} == {"127.0.0.1"}
    return [socket.laddr.port for socket in sockets if socket.status == psutil.CONN_LISTEN]


def answer(port: int, path: str) -> bytes:
    """What is said on a port to somebody without a key."""
    with socket.create_connection(("127.0.0.1", port), 5.0) as connection:
        connection.settimeout(5.0)
        connection.sendall(f"GET {path} HTTP/1.0\r\n\r\n".encode())
        try:
            return connection.recv(100)
        except ConnectionError:
            return b""


@pytest.mark.filterwarnings("ignore::ResourceWarning")
def test_local_workers_obey_only_who_has_the_key_of_the_sweep() -> None:
    with connected(None, 1, 1) as client:
        scheduler: Any = client.scheduler
        address: str = scheduler.address
        assert address.startswith("tls://127.0.0.1:") and client.run(int)
        other: Any = Security
        for protocol, key in (("tcp", None), ("tls", other.temporary())):
            stranger: Any = Client
            with pytest.raises(OSError):
                stranger(address.replace("tls", protocol), security=key, timeout=2.0)
        for port in listening():
            for path in ("/", "/health", "/metrics", "/json/counts.json", "/info/main/workers.html"):
                said = answer(port, path)
                assert not said or said.startswith((b"HTTP/1.1 404", b"\x15\x03")), said  # not found, or a TLS alert


def test_without_cryptography_a_local_sweep_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cryptography", None)
    with pytest.raises(ExperimentError, match=r'pip install "carom\[cluster\]"'), connected(None, 1, 1):
        pass
