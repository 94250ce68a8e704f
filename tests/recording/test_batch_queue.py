"""The mailbox hands out batches, keeps its bound, and loses nothing."""

from __future__ import annotations

import threading

import pytest

from carom.recording.write.batch_queue import Mailbox


def test_what_goes_in_comes_out_in_order_and_in_batches() -> None:
    box: Mailbox[int] = Mailbox(capacity=8, batch=4, seconds=60.0)
    taken: list[list[int]] = []

    def read() -> None:
        while items := box.take():
            taken.append(items)

    reader = threading.Thread(target=read)
    reader.start()
    for item in range(1001):
        box.put(item)
    box.close()
    reader.join(timeout=30)
    assert [item for items in taken for item in items] == list(range(1001))
    assert max(len(items) for items in taken) == 4


def test_a_lone_item_is_handed_out_when_its_time_has_come() -> None:
    box: Mailbox[int] = Mailbox(capacity=8, batch=4, seconds=0.05)
    box.put(7)
    assert box.take() == [7]


def test_a_full_box_makes_the_writer_wait() -> None:
    box: Mailbox[int] = Mailbox(capacity=2, batch=2, seconds=60.0)
    box.put(1)
    box.put(2)
    writer = threading.Thread(target=box.put, args=(3,))
    writer.start()
    writer.join(timeout=0.2)
    assert writer.is_alive()
    assert box.take() == [1, 2]
    writer.join(timeout=30)
    assert not writer.is_alive()


def test_a_writer_who_waits_hears_of_a_failure() -> None:
    box: Mailbox[int] = Mailbox(capacity=1, batch=1, seconds=60.0)
    box.put(1)
    threading.Timer(0.1, box.fail, args=(OSError("full"),)).start()
    with pytest.raises(OSError, match="full"):
        box.put(2)


def test_a_closed_box_ends_with_an_empty_batch() -> None:
    box: Mailbox[int] = Mailbox(capacity=2, batch=2, seconds=60.0)
    box.put(1)
    box.close()
    assert box.take() == [1]
    assert box.take() == []
