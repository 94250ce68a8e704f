"""The index of an .rrd file, its stores and chunks, and the readable messages of a damaged file."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Self

import pyarrow as pa

from carom.errors import DamageError, TornFooterError
from carom.recording.rrd import framing, messages
from carom.recording.rrd.framing import END, MESSAGE_HEADER, STREAM_FOOTER, STREAM_HEADER, Message
from carom.recording.rrd.messages import (
    BLUEPRINT,
    LARGEST,
    RECORDING,
    Chunk,
    Entry,
    Store,
    activated_by,
    decode,
    entry_of,
    read_body,
    record_batch,
    store_named,
    store_of,
)
from carom.recording.timelines import STEP

_ZIP = b"PK\x03\x04"  # first bytes of a zip file, for example of a bug report
_SHORTEST = 100  # smallest size of a chunk's message, in bytes; the schema alone is larger
_MANIFEST = {
    "chunk_entity_path": pa.string(),
    "chunk_is_static": pa.bool_(),
    "chunk_num_rows": pa.uint64(),
    "chunk_byte_offset": pa.uint64(),
    "chunk_byte_size": pa.uint64(),
}


class Container:
    """An .rrd file and the index of its chunks. The file is open only while chunks are read."""

    def __init__(self, path: Path, stores: list[Store], finished: bool) -> None:
        self.path = path
        self.stores = stores
        self.finished = finished  # whether the file has its footer

    @classmethod
    def open(cls, path: Path) -> Self:
        """Index a file. DamageError if a message or the footer is incomplete, OSError if the file cannot be read."""
        with path.open("rb") as file:
            if not framing.is_rrd(file):
                file.seek(0)
                packed = file.read(len(_ZIP)) == _ZIP
                if framing.is_newer(file):
                    raise DamageError("it is in a newer format of .rrd than RRF2: upgrade carom")
                raise DamageError("it is a zip: unpack it" if packed else "it does not begin with an .rrd header")
            footer = framing.read_footer(file)
            if footer is not None:
                return cls(path, _manifests(footer, path.stat().st_size), finished=True)
            index = ChunkIndex(path.stat().st_size)
            for message in framing.messages(file):
                index.add(message, read_body(file, message))
            return cls(path, index.stores(), finished=False)

    def chunks(self, entries: Iterable[Entry]) -> Iterator[Chunk]:
        """Read chunks in order. Raises DamageError if a chunk differs from the index."""
        with self.path.open("rb") as file:
            stored = os.fstat(file.fileno()).st_size
            for entry in entries:
                file.seek(entry.offset)
                _, chunk = decode(file.read(entry.length), stored)
                found = chunk.entity_path, chunk.is_static, chunk.batch.num_rows
                lacks_steps = entry.first_step is not None and STEP not in chunk.timelines
                if found != (entry.entity_path, entry.is_static, entry.rows) or lacks_steps:
                    raise DamageError(f"at byte {entry.offset} is not the expected chunk of /{entry.entity_path}")
                yield chunk


class ChunkIndex:
    """An index that is built message by message, for a file of ``stored`` bytes without a footer."""

    def __init__(self, stored: int) -> None:
        self._stored = stored
        self._stores: dict[tuple[int, str], Store] = {}
        self._activated: set[str] = set()

    def add(self, message: Message, body: bytes) -> None:
        """Add a message. Raises DamageError if the message cannot be decoded."""
        match message.kind:
            case framing.STORE:
                self._known(store_of(body))
            case framing.ACTIVATION:
                self._activated.add(activated_by(body).store_id)
            case framing.CHUNK:
                store, chunk = decode(body, self._stored)
                self._known(store).entries.append(entry_of(chunk, message))

    def stores(self) -> list[Store]:
        """Return the stores, without layouts that were not sent completely."""
        return [s for s in self._stores.values() if s.kind != BLUEPRINT or s.store_id in self._activated]

    def _known(self, store: Store) -> Store:
        return self._stores.setdefault((store.kind, store.store_id), store)


def _manifests(footer: bytes, size: int) -> list[Store]:
    """Read the entries of each store's chunks from the footer, in the order of the file."""
    stores = []
    for manifest in messages.fields(memoryview(footer)).get(1, []):
        if not isinstance(manifest, memoryview):
            raise DamageError("malformed footer")
        parts = messages.fields(manifest)
        table = messages.fields(messages.data(parts, 4))
        batch = record_batch(messages.data(table, 2), messages.number(table, 3), messages.number(table, 4), size)
        store = store_named(messages.data(parts, 1))
        if batch.num_rows > size // _SHORTEST:
            raise DamageError(f"its footer lists {batch.num_rows} chunks in {size} bytes")
        columns = [_manifest_column(batch, name, kind) for name, kind in _MANIFEST.items()]
        if any(None in column for column in columns):
            raise DamageError("its footer describes chunks incompletely")
        for name in (f"{STEP}:start", f"{STEP}:end"):
            there = name in batch.schema.names
            columns.append(_manifest_column(batch, name, pa.int64()) if there else [None] * batch.num_rows)
        for path, static, rows, offset, length, first, last in zip(*columns, strict=True):
            store.entries.append(Entry(path.lstrip("/"), static, rows, first, last, offset, length))
        store.entries.sort(key=lambda entry: entry.offset)
        stores.append(store)
    # if chunks could share bytes, a small file could claim any number of rows
    end = framing.STREAM_HEADER
    for entry in sorted((entry for store in stores for entry in store.entries), key=lambda entry: entry.offset):
        if entry.length > LARGEST:
            raise DamageError(f"its footer lists a chunk of {entry.length} bytes")
        if entry.offset < end or entry.offset + entry.length > size:
            raise DamageError(f"its footer lists a chunk at byte {entry.offset}, where no chunk can be")
        end = entry.offset + entry.length
    return sorted(stores, key=lambda store: min((entry.offset for entry in store.entries), default=0))


def _manifest_column(manifest: pa.RecordBatch, name: str, kind: pa.DataType) -> list[Any]:
    if name not in manifest.schema.names:
        raise DamageError(f"its footer has no {name}")
    if manifest[name].type != kind:
        raise DamageError(f"its footer has {name} of type {manifest[name].type}")
    return list(manifest[name].to_pylist())


_WINDOW = 1 << 22  # bytes searched at a time
# a message begins with field 1 as bytes
_MESSAGE = re.compile(rb"[\x00-\x03]\x00{7}[\x00-\xff]{5}\x00{3}\n", re.DOTALL)
_PATIENCE = 4  # largest number of bytes read in the search for messages, in sizes of the file


@dataclass(frozen=True, slots=True)
class Gap:
    """Bytes that cannot be decoded."""

    offset: int
    length: int
    reason: str


@dataclass(slots=True)
class Salvage:
    """The result of one pass through a file."""

    stores: list[Store] = field(default_factory=list)
    gaps: list[Gap] = field(default_factory=list)
    missing: list[Entry] = field(default_factory=list)  # entries that the footer lists, but that cannot be read
    layout_lost: bool = False
    finished: bool = False  # whether the file has a footer that matches its chunks


def salvage(path: Path) -> Salvage:
    """Decode every readable message of a file. Raises OSError if the file cannot be read."""
    found = Salvage()
    listed = _listed(path)
    with path.open("rb") as file:
        _Pass(file, path.stat().st_size, found).go()
    if listed is not None:
        # only chunks that match the footer are kept
        readable = {(store.kind, store.store_id): set(store.entries) for store in found.stores}
        for store in listed:
            gone = [entry for entry in store.entries if entry not in readable.get((store.kind, store.store_id), set())]
            store.entries[:] = [entry for entry in store.entries if entry not in gone]
            if store.kind == RECORDING:
                found.missing += gone
            elif gone:
                found.layout_lost = True
                store.entries.clear()
        found.stores = listed
        found.finished = not (found.missing or found.layout_lost or found.gaps)
    return found


def _listed(path: Path) -> list[Store] | None:
    """Read the footer's index; None without a valid footer."""
    with path.open("rb") as file:
        try:
            if framing.read_footer(file) is None:
                return None
        except DamageError:
            return None
    try:
        return Container.open(path).stores
    except (DamageError, LookupError, TypeError, ValueError):
        return None


class _Pass:
    """One pass through the messages of a file that skips all other bytes."""

    def __init__(self, file: BinaryIO, size: int, found: Salvage) -> None:
        self._file = file
        self._size = size
        self._found = found
        self._index = ChunkIndex(size)
        self._budget = _PATIENCE * size

    def go(self) -> None:
        """Read through the file and fill in the result."""
        at = STREAM_HEADER
        if not framing.is_rrd(self._file):
            self._found.gaps.append(Gap(0, STREAM_HEADER, "it does not begin like a recording"))
        while at < self._size:
            try:
                message = next(framing.messages(self._file, at))
                self._index.add(message, self._body(message))
            except TornFooterError:
                break
            except DamageError as error:
                following = self._next(at + 1)
                self._found.gaps.append(Gap(at, following - at, str(error)))
                at = following
                continue
            at = message.end
            if message.kind == END:
                # the bytes after the footer are lost
                more = self._size - (at + STREAM_FOOTER)
                if more > 0:
                    self._found.gaps.append(Gap(at + STREAM_FOOTER, more, "bytes after its end"))
                break
        self._found.stores = self._index.stores()

    def _body(self, message: Message) -> bytes:
        if message.kind == END:
            if self._size - message.end >= STREAM_FOOTER and not framing.is_footer(self._file, message.end):
                raise DamageError("an end in the middle")
            return b""
        if message.length > LARGEST:
            raise DamageError(f"a message of {message.length} bytes")
        self._budget -= message.length
        return read_body(self._file, message)

    def _next(self, at: int) -> int:
        """Return the offset of the next readable message, or the file's size."""
        while at < self._size and self._budget > 0:
            self._file.seek(at)
            window = self._file.read(_WINDOW + MESSAGE_HEADER)
            self._budget -= len(window)
            for match in _MESSAGE.finditer(window):
                if self._can_be_read(at + match.start()):
                    return at + match.start()
            at += _WINDOW
        return self._size

    def _can_be_read(self, at: int) -> bool:
        if self._budget <= 0:
            return False
        try:
            message = next(framing.messages(self._file, at))
            ChunkIndex(self._size).add(message, self._body(message))
        except DamageError:
            return False
        return True
