"""The process that keeps the viewer to its user. A small server stands in for the viewer."""

from __future__ import annotations

import contextlib
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest

from carom.display import keeper
from carom.display.viewer import Viewer
from needs import PICTURES
from other_user import as_root, run_as_nobody
from page_requests import requests_of_pages

# answers every connection with the number of its user, and leaves a file in the temporary folder
SERVER = """
import os, socket, sys, tempfile
tempfile.mkdtemp()
listener = socket.create_server(("127.0.0.1", int(sys.argv[sys.argv.index("--port") + 1])))
while True:
    listener.accept()[0].sendall(b"I am %d" % os.getuid())
"""
# starts a keeper, as `Viewer` does, and waits
PARENT = """
import os, subprocess, sys, time
folder, keeper, options, screen, server = sys.argv[1:]
reads, writes = os.pipe()
command = [sys.executable, "-I", "-S", keeper, str(os.getpid()), str(writes), folder, options, screen]
process = subprocess.Popen([*command, sys.executable, "-c", server], pass_fds=(writes,), start_new_session=True)
os.close(writes)
print(process.pid, os.read(reads, 100).decode(), flush=True)
time.sleep(600)
"""
linux = pytest.mark.skipif(sys.platform != "linux", reason="namespaces are Linux's")
START_OF_HTTP2 = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])  # of which gRPC is made
LIMIT = 30.0  # s, on a busy machine


@dataclass(frozen=True)
class Kept:
    """A server that is kept."""

    folder: Path  # for its temporary files
    port: int
    parent: psutil.Process
    keeper: psutil.Process
    server: psutil.Process


@contextlib.contextmanager
def kept(tmp_path: Path, options: str = "", prefix: tuple[str, ...] = (), screen: str = "") -> Iterator[Kept]:
    folder = tmp_path / "folder"
    folder.mkdir(mode=0o700)
    command = [*prefix, sys.executable, "-c", PARENT, str(folder), keeper.__file__, options, screen, SERVER]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        pid, port = map(int, parent.stdout.readline().split())
        keeping = psutil.Process(pid)
        try:
            yield Kept(folder, port, psutil.Process(parent.pid), keeping, keeping.children()[-1])
        finally:
            parent.kill()
            with contextlib.suppress(psutil.NoSuchProcess):
                keeping.terminate()
                keeping.wait(LIMIT)


@pytest.fixture(scope="module")
def one_kept(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Kept]:
    """Keep a server for several tests."""
    with kept(tmp_path_factory.mktemp("kept")) as one:
        if not is_isolated(one.server):
            pytest.skip("no namespace is granted here")
        yield one


def answer_to_nobody(port: int, request: bytes) -> str:
    """Describe the answer of a port to another user."""
    return run_as_nobody(f"""
try:
    connection = socket.create_connection(("127.0.0.1", {port}), timeout={LIMIT})
    connection.sendall({request!r})
    print(connection.recv(100) or "nothing")
except ConnectionError:
    print("nothing")
""")


def asked(port: int) -> bytes:
    with socket.create_connection(("127.0.0.1", port), timeout=LIMIT) as connection:
        connection.sendall(START_OF_HTTP2)
        return connection.recv(100)


def wait_for(done: Callable[[], bool]) -> None:
    end = time.monotonic() + LIMIT
    while not done():
        assert time.monotonic() < end, "it did not happen"
        time.sleep(0.05)


def is_isolated(process: psutil.Process) -> bool:
    here, there = (Path(f"/proc/{pid}/ns/net").readlink() for pid in ("self", process.pid))
    return here != there


@linux
@as_root
def test_another_user_reaches_no_port_of_a_viewer(tmp_path: Path) -> None:
    with kept(tmp_path) as one:
        assert is_isolated(one.server), "this machine grants namespaces"
        assert asked(one.port) == f"I am {os.getuid()}".encode(), "its own user does"
        assert answer_to_nobody(one.port, b"") == "nothing"
        ours = [socket for socket in psutil.net_connections("tcp") if socket.pid in (one.keeper.pid, one.server.pid)]
        listening = {socket.laddr.port for socket in ours if socket.status == psutil.CONN_LISTEN}
        assert listening == {one.port}, "there is no other port to try"


@linux
@as_root
def test_a_web_page_in_the_users_own_browser_reaches_no_port_of_a_viewer(one_kept: Kept) -> None:
    for request in requests_of_pages(one_kept.port)[::3]:
        with socket.create_connection(("127.0.0.1", one_kept.port), timeout=LIMIT) as connection:
            with contextlib.suppress(ConnectionError):
                connection.sendall(request)
            with contextlib.suppress(ConnectionResetError):
                assert connection.recv(100) == b"", request


@linux
@as_root
def test_a_call_whose_beginning_arrives_in_pieces_reaches_the_viewer(one_kept: Kept) -> None:
    with socket.create_connection(("127.0.0.1", one_kept.port), timeout=LIMIT) as connection:
        for byte in START_OF_HTTP2:
            connection.sendall(bytes([byte]))
        assert connection.recv(100).startswith(b"I am")


@linux
@as_root
@pytest.mark.skipif(shutil.which("Xvfb") is None, reason="no Xvfb")
@pytest.mark.parametrize("options", ["", keeper.SHARED])
def test_another_user_cannot_look_at_the_virtual_screen(tmp_path: Path, options: str) -> None:
    with kept(tmp_path, options, screen="320x200") as one:
        display = one.server.environ()["DISPLAY"].removeprefix(":")
        greeting = b"l\0\x0b\0\0\0\0\0\0\0\0\0"  # X11, protocol 11, without a cookie
        answer = run_as_nobody(f"""
connection = socket.socket(socket.AF_UNIX)
connection.connect("/tmp/.X11-unix/X{display}")
connection.sendall({greeting!r})
print(connection.recv(1)[0])
""")
        assert answer == "0", "refused"


@linux
def test_where_no_namespace_is_granted_the_viewer_still_runs(tmp_path: Path) -> None:
    refused = 'echo 0 >/proc/sys/user/max_net_namespaces && exec "$@"'
    prefix = ("unshare", "--user", "--map-root-user", "sh", "-c", refused, "sh")
    if subprocess.run([*prefix, "true"], check=False, capture_output=True).returncode != 0:
        pytest.skip("user namespaces are refused already")
    with kept(tmp_path, prefix=prefix) as one:
        assert not is_isolated(one.server)
        assert asked(one.port).startswith(b"I am")


def test_a_viewer_that_must_reach_a_server_stays_in_the_namespace_of_the_machine(tmp_path: Path) -> None:
    with kept(tmp_path, keeper.SHARED) as one:
        assert asked(one.port) == f"I am {os.getuid()}".encode()
        assert f"--port {one.port}" in " ".join(one.server.cmdline())


@pytest.mark.parametrize("options", ["", keeper.SHARED])
def test_a_killed_parent_leaves_neither_process_nor_folder(tmp_path: Path, options: str) -> None:
    with kept(tmp_path, options) as one:
        assert any(one.folder.iterdir()), "the temporary files of the viewer are in its folder"
        one.parent.send_signal(signal.SIGKILL)
        wait_for(lambda: not (one.keeper.is_running() or one.server.is_running() or one.folder.exists()))


@linux
def test_a_killed_keeper_leaves_no_viewer(tmp_path: Path) -> None:
    with kept(tmp_path) as one:
        one.keeper.kill()
        wait_for(lambda: not one.server.is_running())


def test_a_live_viewer_outlives_its_run_and_leaves_no_folder(tmp_path: Path) -> None:
    with kept(tmp_path, keeper.LIVE) as one:
        one.parent.kill()
        one.parent.wait(LIMIT)
        time.sleep(3 * keeper._POLL)
        assert one.server.is_running() and one.folder.exists()
        one.server.kill()
        wait_for(lambda: not (one.keeper.is_running() or one.folder.exists()))


@linux
def test_the_owner_of_a_connection_is_recognised_and_that_of_a_closed_one_is_not() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        here = listener.getsockname()
        assert keeper.is_ours(here)
        client = socket.create_connection(here)
        there = client.getsockname()
        with listener.accept()[0]:
            assert keeper.is_ours(there, here)
            client.close()
            assert not keeper.is_ours(there, here)


@pytest.mark.slow
@as_root
@pytest.mark.needs(PICTURES)
def test_another_user_cannot_control_the_viewer_of_a_picture() -> None:
    with Viewer("--headless") as viewer:
        port = int(viewer.address.rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port), timeout=LIMIT) as ours:
            ours.sendall(START_OF_HTTP2)
            assert ours.recv(100), "it answers its own user"
        assert answer_to_nobody(port, START_OF_HTTP2) == "nothing"
