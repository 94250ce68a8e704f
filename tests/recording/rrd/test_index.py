import struct
from pathlib import Path

import numpy as np
import pytest
from rerun.chunk import RrdReader

from carom.errors import DamageError, RecordingError
from carom.recording.read.recording import Recording
from carom.recording.rrd.container import Container
from carom.recording.rrd.framing import MESSAGE_HEADER, STREAM_FOOTER, Message, messages
from carom.recording.rrd.messages import BLUEPRINT, LARGEST, RECORDING
from carom.recording.schema import checkpoint_columns


def without_footer(path: Path) -> Path:
    """Leave out what a killed run has not written."""
    with path.open("rb") as file:
        end = next(message for message in messages(file) if message.kind == 0)
    path.write_bytes(path.read_bytes()[: end.offset - MESSAGE_HEADER])
    return path


def chunk_of(path: Path, entity: str) -> Message:
    """Find the first chunk of an entity in a whole file."""
    store = Container.open(path).stores[0]
    entry = next(entry for entry in store.entries if entry.entity_path == entity and not entry.is_static)
    return Message(2, entry.offset, entry.length)


def test_chunks_are_read_as_reruns_own_reader_reads_them(run_file: Path) -> None:
    container = Container.open(run_file)
    store = next(store for store in container.stores if store.kind == RECORDING)
    theirs = {str(chunk.id): chunk for chunk in RrdReader(run_file).store().stream()}
    ours = list(container.chunks(store.entries))
    assert len(ours) == len(theirs) > 20
    for chunk in ours:
        same = theirs[chunk.batch.schema.metadata[b"rerun:id"].decode()]
        assert "/" + chunk.entity_path == same.entity_path and chunk.is_static == same.is_static
        batch = same.to_record_batch()
        assert set(chunk.batch.schema.names) == set(batch.schema.names)
        assert all(
            repr(chunk.batch[n].to_pylist()) == repr(batch[n].to_pylist()) for n in batch.schema.names
        )  # NaN, too


def test_a_file_without_footer_has_the_same_index_as_with_it(run_file: Path) -> None:
    whole = Container.open(run_file)
    torn = Container.open(without_footer(run_file))
    assert whole.finished and not torn.finished
    assert whole.stores == torn.stores
    assert [store.kind for store in torn.stores] == [RECORDING, BLUEPRINT]


def test_a_footer_with_one_wrong_bit_is_not_believed(run_file: Path) -> None:
    content = bytearray(run_file.read_bytes())
    content[-STREAM_FOOTER - 1000] ^= 1
    run_file.write_bytes(content)
    with pytest.raises(DamageError, match="checksum"):
        Container.open(run_file)


@pytest.mark.parametrize("claim", [1 << 20, 1 << 40, (1 << 64) - 1])
def test_a_message_that_claims_more_than_the_file_has_is_not_read(run_file: Path, claim: int) -> None:
    without_footer(run_file)
    content = bytearray(run_file.read_bytes())
    with run_file.open("rb") as file:
        last = list(messages(file))[-1]
    content[last.offset - 8 : last.offset] = struct.pack("<Q", claim)
    run_file.write_bytes(content)
    with pytest.raises(RecordingError, match=r"ends inside a message.*`carom repair .*run\.rrd`"):
        Recording.open(run_file)


def test_a_chunk_that_claims_to_unpack_to_terabytes_is_not_unpacked(run_file: Path) -> None:
    where = chunk_of(run_file, "state/checkpoint")
    content = bytearray(run_file.read_bytes())
    at = content.index(b"\x10\x02\x18", where.offset) + 3  # the fields compression = LZ4 and uncompressed_size
    claimed = content[at : at + 3]
    assert claimed[0] & 0x80 and claimed[1] & 0x80, "three bytes of a number, the first two to be continued"
    content[at + 2] |= 0x80  # now it goes on into what follows
    run_file.write_bytes(content)
    with pytest.raises(RecordingError, match="carom repair"):
        Recording.open(run_file).checkpoint(0)


def test_a_chunk_of_noise_is_told_in_one_sentence(run_file: Path) -> None:
    where = chunk_of(run_file, "energy/total")
    content = bytearray(run_file.read_bytes())
    noise = np.random.default_rng(1).bytes(where.length // 2)
    content[where.end - len(noise) : where.end] = noise
    run_file.write_bytes(content)
    recording = Recording.open(run_file)
    assert recording.frames == 100, "the others can be read"
    with pytest.raises(RecordingError, match=r"damaged \(.*\); `carom repair .*run\.rrd` recovers the readable data"):
        recording.energy()


def test_the_state_of_ten_million_bodies_that_spin_is_not_too_large_to_be_read() -> None:
    assert checkpoint_columns._largest_size(10**7, 0, 1) <= LARGEST  # a checkpoint is one chunk
