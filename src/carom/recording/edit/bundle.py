"""Writes and reads the zip file that is attached to a bug report.

A bundle may come from a stranger. Only its recording is written to disk, under a name that carom chooses, and with no
more bytes than the bundle declares.
"""

from __future__ import annotations

import shutil
import struct
import zipfile
import zlib
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from carom.errors import RecordingError
from carom.private_folder import temporary_folder
from carom.recording.write.whole_file import Claim, whole_file

CLIP = "clip.rrd"
LARGEST = 10_000_000  # largest size of a bundle in bytes, a common limit for attachments
MOST_UNPACKED = 1_000_000_000  # largest size of an unpacked recording in bytes
MOST_TIMES = 1000  # highest compression ratio of deflate; a higher ratio is a zip bomb
MOST_MEMBERS = 100
_PIECE = 1 << 20

_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)
_SURPRISES = (
    *(zipfile.BadZipFile, zlib.error, struct.error),
    *(EOFError, LookupError, NotImplementedError, RuntimeError, ValueError, OSError),
)


def is_bundle(path: Path) -> bool:
    """Return whether a file starts like a zip file."""
    try:
        if not path.is_file():  # opening a pipe would block
            return False
        with path.open("rb") as file:
            return file.read(4) == b"PK\x03\x04"
    except OSError:
        return False


def pack(path: Path, members: Mapping[str, bytes | Path]) -> int:
    """Write a bundle atomically; return its size in bytes. Raises RecordingError if the file cannot be written."""
    with Claim(path):
        try:
            with whole_file(path) as part, zipfile.ZipFile(part, "w", zipfile.ZIP_DEFLATED, compresslevel=9) as bundle:
                for name, content in members.items():
                    if isinstance(content, Path):
                        bundle.write(content, name)
                    else:
                        bundle.writestr(name, content)
            return path.stat().st_size
        except OSError as error:
            raise RecordingError(f"cannot write {path}: {error.strerror}") from error


@contextmanager
def opened(path: Path) -> Iterator[Path]:
    """Yield the path of a recording: the file itself, or while the context lasts, a file unpacked from a bundle.

    Raises RecordingError if a bundle is damaged, or contains no recording, or a malformed recording.
    """
    if not is_bundle(path):
        yield path
        return
    with temporary_folder() as folder:
        out = folder / path.with_suffix(".rrd").name
        try:
            with zipfile.ZipFile(path) as bundle:
                infos = bundle.infolist()
                if len(infos) > MOST_MEMBERS:
                    raise ValueError(f"{len(infos)} files in it are too many")
                found = [info for info in infos if info.filename == CLIP]
                if len(found) != 1:
                    raise ValueError(f"there must be one {CLIP} in it, not {len(found)}")
                info = found[0]
                if info.compress_type not in _METHODS:
                    raise ValueError(f"{CLIP} in it is compressed by method {info.compress_type} instead of deflate")
                if info.file_size > min(MOST_UNPACKED, MOST_TIMES * max(1, info.compress_size)):
                    raise ValueError(f"{CLIP} in it claims to unpack to {info.file_size} bytes")
                if shutil.disk_usage(out.parent).free < info.file_size:
                    raise ValueError(f"{CLIP} in it unpacks to {info.file_size} bytes, for which there is no space")
                with bundle.open(info) as source, out.open("wb") as target:
                    left = info.file_size
                    while piece := source.read(min(_PIECE, left + 1)):
                        left -= len(piece)
                        if left < 0:
                            raise ValueError(f"{CLIP} in it unpacks to more than it claims")
                        target.write(piece)
        except _SURPRISES as error:
            raise RecordingError(f"{path} is not a bundle made by carom, or is damaged ({error})") from error
        try:
            yield out
        except RecordingError as error:  # the message should name the bundle, not the temporary file
            error.args = (str(error).replace(str(out), str(path)), *error.args[1:])
            raise
