"""What a web page can have a browser send to a port of this machine, under a name that it makes point there."""

from __future__ import annotations

import itertools

_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"  # a page may put it into the body of a request only
_HOSTS = ("rebound.example", "127.0.0.1", "localhost", "LOCALHOST", "localhost.", "[::1]", "0.0.0.0", "2130706433")
_ODD_HOSTS = ("", "[", "evil@127.0.0.1", "127.0.0.1.rebound.example", "rebound.example/127.0.0.1")
_ORIGINS = ("", "Origin: null\r\n", "Origin: http://rebound.example\r\n", "Origin: http://127.0.0.1\r\n")
_UPGRADES = (
    "Connection: Upgrade, HTTP2-Settings\r\nUpgrade: h2c\r\nHTTP2-Settings: AAMAAABkAAQAoAAAAAIAAAAA\r\n",
    "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Key: x3JJHMbDL1EzLkh9GBhXDw==\r\n",
    "Access-Control-Request-Method: POST\r\nAccess-Control-Request-Private-Network: true\r\n",
)


def requests_of_pages(port: int, path: str = "/") -> list[bytes]:
    """Return requests for a path, by names of this machine and of others, from several origins."""
    hosts = [*_HOSTS, *_ODD_HOSTS, f"rebound.example:{port}", f"127.0.0.1:{port}"]
    heads = [f"{path} HTTP/1.1\r\nHost: {host}\r\n{origin}" for host, origin in itertools.product(hosts, _ORIGINS)]
    made = [f"GET {head}\r\n".encode() for head in heads]
    made += [f"POST {head}Content-Length: {len(_PREFACE)}\r\n\r\n".encode() + _PREFACE for head in heads]
    made += [f"OPTIONS {head}{more}\r\n".encode() + _PREFACE for head in heads[::7] for more in _UPGRADES]
    return [*made, f"GET {path}\r\n\r\n".encode(), b"PRI / HTTP/1.1\r\n\r\n" + _PREFACE, b"\r\n" + _PREFACE]
