"""Restricts Rerun's viewer to its user, and ends it together with carom.

The viewer is controlled through a port without a password: anybody who connects can read and write files as the
viewer's user. This program, which `Viewer` starts, therefore puts the viewer into a network namespace of its own, where
nobody can connect, and forwards connections of the same user to it. A connection must begin like HTTP/2, as connections
of Rerun's SDK do. A web page in the user's browser sends HTTP/1.1, and could otherwise use the port through a name that
it lets point to 127.0.0.1. Where the system grants no namespace (other systems than Linux, most containers, Ubuntu's
restriction of user namespaces) the port is open to all users of the machine, and to such pages, while the viewer runs.

The program ends the viewer and deletes its temporary folder when the process that started it has ended, even by
``kill -9``. It uses the standard library alone and starts within milliseconds.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import secrets
import shutil
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from io import FileIO
from pathlib import Path

HOST = "127.0.0.1"  # address of the viewer, which by default listens on all interfaces
SHARED = "shared"  # the viewer stays in the namespace of the machine, to reach a server or an X display
LIVE = "live"  # the viewer may outlive the run that it shows
_SCREENS = ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET")
_START = 60.0  # s, time limit for the start of the viewer
_GRACE = 5.0  # s between requesting the end of a process and killing it
_POLL = 0.2  # s, interval of checks
_PORT = 9876  # port of the viewer in a namespace of its own
_PIECE = 1 << 20  # bytes, largest read of a forwarded connection
# first bytes of a connection (RFC 9113, 3.4); no browser sends these in plain text
_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
_TABLE = "/proc/net/tcp"  # Linux's table of sockets with their owners
_LISTENS, _ESTABLISHED = "0A", "01"
_NEW_USER, _NEW_NET = 0x10000000, 0x40000000  # flags of unshare(2)
_SET_FLAGS, _UP = 0x8914, 0x1  # SIOCSIFFLAGS, IFF_UP
_DIE_WITH_PARENT = 1  # PR_SET_PDEATHSIG

Address = tuple[str, int]


def is_ours(local: Address, remote: Address = ("0.0.0.0", 0), table: FileIO | None = None) -> bool:
    """Return whether the socket at ``local`` is connected to ``remote``, or listens, and belongs to this user.

    A connection that its owner has closed belongs to nobody. Without the table of sockets, no connection counts as this
    user's. A process that has left the machine's network namespace passes the machine's table.
    """
    try:
        if table is None:
            text = Path(_TABLE).read_text(encoding="ascii")
        else:
            table.seek(0)
            text = table.readall().decode("ascii")
    except OSError:
        return False
    wanted = [_in_table(local), _in_table(remote), _LISTENS if remote[1] == 0 else _ESTABLISHED]
    rows = [line.split() for line in text.splitlines()[1:]]
    return any(row[1:4] == wanted and int(row[7]) == os.geteuid() for row in rows)


def _in_table(address: Address) -> str:
    return f"{int.from_bytes(socket.inet_aton(address[0]), sys.byteorder):08X}:{address[1]:04X}"


def has_screen() -> bool:
    """Return whether windows can be opened, judging by the environment."""
    return sys.platform != "linux" or any(os.environ.get(name) for name in _SCREENS)


def screen_is_remote() -> bool:
    """Return whether windows go to an X display by TCP, as under ``ssh -X``."""
    display = "" if os.environ.get("WAYLAND_DISPLAY") else os.environ.get("DISPLAY", "")
    return display.partition(":")[0] not in ("", "unix")


def isolate() -> bool:
    """Move this process into a network namespace of its own, in which only loopback exists; return whether it succeeds.

    Only a process with a single thread can move.
    """
    if sys.platform != "linux" or len(list(Path("/proc/self/task").iterdir())) != 1:
        return False
    # Root keeps its rights over other users' files only if there is no user namespace.
    for flags in (_NEW_NET, _NEW_USER | _NEW_NET) if os.geteuid() == 0 else (_NEW_USER | _NEW_NET,):
        trial = os.fork()  # tried in a child, since a part of it may succeed and cannot be undone
        if trial == 0:
            os._exit(0 if _unshare(flags) else 1)
        if os.waitpid(trial, 0)[1] == 0:
            return _unshare(flags)
    return False


def _unshare(flags: int) -> bool:
    user, group = os.geteuid(), os.getegid()
    if ctypes.CDLL(None, use_errno=True).unshare(flags) != 0:
        return False
    try:
        if flags & _NEW_USER:
            Path("/proc/self/setgroups").write_text("deny")
            Path("/proc/self/uid_map").write_text(f"{user} {user} 1")
            Path("/proc/self/gid_map").write_text(f"{group} {group} 1")
        with socket.socket() as any_socket:
            fcntl.ioctl(any_socket, _SET_FLAGS, struct.pack("16sH14x", b"lo", _UP))
    except OSError:
        return False
    return True


def free_port() -> int:
    """Return a free port of this machine."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return int(probe.getsockname()[1])


class Door:
    """A port of the machine through which only the user of this process reaches a port in the namespace."""

    def __init__(self) -> None:
        self._table: FileIO | None = None  # table of the machine, not of the namespace
        with contextlib.suppress(OSError):
            self._table = Path(_TABLE).open("rb", buffering=0)  # noqa: SIM115  read again for every connection
        self._listener = socket.create_server((HOST, 0))
        self._listener.settimeout(_POLL)
        self.address: Address = self._listener.getsockname()

    def knows_us(self) -> bool:
        """Return whether the table recognises a connection of this user; in some sandboxes it is incomplete."""
        with socket.create_connection(self.address) as ours, self._listener.accept()[0]:
            return is_ours(ours.getsockname(), self.address, self._table)

    def serve(self, port: int) -> None:
        """Wait up to `_POLL` for a connection; forward it to a port in the namespace."""
        try:
            connection, peer = self._listener.accept()
        except TimeoutError:
            return
        if not is_ours(peer, self.address, self._table):
            connection.close()
            return
        connection.settimeout(None)
        with contextlib.suppress(RuntimeError):  # raised if no thread can be started
            threading.Thread(target=_forward_calls, args=(connection, port), daemon=True).start()


def _forward_calls(connection: socket.socket, port: int) -> None:
    """Forward an HTTP/2 connection to the viewer or server on a port; close any other connection."""
    begun = b""
    with contextlib.suppress(OSError, RuntimeError):
        while len(begun) < len(_PREFACE) and _PREFACE.startswith(begun):
            piece = connection.recv(len(_PREFACE) - len(begun))
            if not piece:
                break
            begun += piece
        if begun == _PREFACE:
            viewer = socket.create_connection((HOST, port))
            viewer.sendall(begun)
            threading.Thread(target=_forward, args=(viewer, connection), daemon=True).start()
            _forward(connection, viewer)
            return
    connection.close()


def _forward(source: socket.socket, sink: socket.socket) -> None:
    """Copy data from one socket to another until the data end."""
    with contextlib.suppress(OSError):
        while piece := source.recv(_PIECE):
            sink.sendall(piece)
    for end, how in ((sink, socket.SHUT_WR), (source, socket.SHUT_RD)):
        with contextlib.suppress(OSError):
            end.shutdown(how)


class _Children:
    """Child processes, which end with this process. Leaving the context ends them in reverse order."""

    def __init__(self) -> None:
        self._started: list[subprocess.Popen[bytes]] = []

    def __enter__(self) -> _Children:
        return self

    def __exit__(self, *_: object) -> None:
        for child in reversed(self._started):
            child.terminate()
            try:
                child.wait(_GRACE)
            except subprocess.TimeoutExpired:
                child.kill()
                child.wait()

    def start(self, command: Sequence[str], environment: dict[str, str], keep: tuple[int, ...] = ()) -> None:
        """Start a process."""
        process = subprocess.Popen(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            pass_fds=keep,
            preexec_fn=_die_with_parent,  # noqa: PLW1509  there are no threads yet
        )
        self._started.append(process)

    def ended(self) -> int | None:
        """Return the exit status of the last process; None while it runs."""
        return self._started[-1].poll()


def _die_with_parent() -> None:
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGKILL)


def _start_screen(children: _Children, size: str, folder: Path, environment: dict[str, str]) -> dict[str, str]:
    """Start Xvfb; return the environment of its clients. Clients need a cookie, so that nobody else can connect."""
    cookie, name = secrets.token_bytes(16), b"MIT-MAGIC-COOKIE-1"
    authority = folder / "authority"
    any_display = struct.pack(">HHH", 0xFFFF, 0, 0)
    authority.write_bytes(any_display + struct.pack(">H", len(name)) + name + struct.pack(">H", len(cookie)) + cookie)
    reads, writes = os.pipe()
    options = ("-screen", "0", f"{size}x24", "-auth", str(authority), "-nolisten", "tcp", "-displayfd", str(writes))
    children.start(["Xvfb", *options], environment, (writes,))
    os.close(writes)
    with os.fdopen(reads) as display:
        number = display.readline().strip()  # empty if Xvfb has ended
    if not number:
        sys.exit("Xvfb, the virtual screen, did not start")
    return environment | {"DISPLAY": f":{number}", "XAUTHORITY": str(authority)}


def _wait_for(children: _Children, port: int) -> None:
    """Wait until the viewer listens; exit if it ends first, or does not listen within `_START`."""
    end = time.monotonic() + _START
    while True:
        with contextlib.suppress(ConnectionRefusedError), socket.create_connection((HOST, port)):
            return
        if (status := children.ended()) is not None:
            sys.exit(status or 1)
        if time.monotonic() > end:
            sys.exit(f"the viewer did not start within {_START:.0f} s")
        time.sleep(_POLL / 4)


def keep(parent: int, report: int, folder: Path, options: Sequence[str], screen: str, command: Sequence[str]) -> int:
    """Run a viewer until the viewer or the parent process ends; return the viewer's exit status.

    Once the viewer listens, its port is written to the descriptor ``report``. ``folder`` is its temporary folder,
    ``options`` may contain `SHARED` and `LIVE`, ``screen`` is the WIDTHxHEIGHT of a virtual screen for the viewer, or
    empty, and ``command`` starts the viewer, without its port.
    """
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
    door, port, environment = Door(), _PORT, os.environ | {"TMPDIR": str(folder)}
    isolated = SHARED not in options and door.knows_us() and isolate()
    if not isolated:
        port = free_port()
    with _Children() as children:
        if screen:
            environment = _start_screen(children, screen, folder, environment)
        children.start([*command, "--bind", HOST, "--port", str(port)], environment)
        _wait_for(children, port)
        if not isolated and door.knows_us() and not is_ours((HOST, port)):
            sys.exit(f"port {port} was taken by another user of this machine; try again")
        os.write(report, f"{door.address[1] if isolated else port}\n".encode())
        os.close(report)
        while (status := children.ended()) is None and (LIVE in options or os.getppid() == parent):
            if isolated:
                door.serve(port)
            else:
                time.sleep(_POLL)
    return 1 if status is None else status


if __name__ == "__main__":
    _, started_by, writes_to, temporary, chosen, screen_size, *viewer = sys.argv
    try:
        sys.exit(keep(int(started_by), int(writes_to), Path(temporary), chosen.split(","), screen_size, viewer))
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
