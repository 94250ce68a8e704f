"""The queue hands out batches, keeps its bound, and loses nothing."""

from __future__ import annotations

import threading

import pytest

from carom.recording.write.recorder import BatchQueue


def test_a_batch_queue_hands_out_frames_in_order_and_in_batches() -> None:
    queue: BatchQueue[int] = BatchQueue(capacity=8, batch=4, seconds=60.0)
    taken: list[list[int]] = []

    def read() -> None:
        while items := queue.take():
            taken.append(items)

    reader = threading.Thread(target=read)
    reader.start()
    for item in range(1001):
        queue.put(item)
    queue.close()
    reader.join(timeout=30)
    assert [item for items in taken for item in items] == list(range(1001))
    assert max(len(items) for items in taken) == 4


def test_a_lone_item_is_handed_out_when_its_time_has_come() -> None:
    queue: BatchQueue[int] = BatchQueue(capacity=8, batch=4, seconds=0.05)
    queue.put(7)
    assert queue.take() == [7]


def test_a_full_queue_makes_the_writer_wait() -> None:
    queue: BatchQueue[int] = BatchQueue(capacity=2, batch=2, seconds=60.0)
    queue.put(1)
    queue.put(2)
    writer = threading.Thread(target=queue.put, args=(3,))
    writer.start()
    writer.join(timeout=0.2)
    assert writer.is_alive()
    assert queue.take() == [1, 2]
    writer.join(timeout=30)
    assert not writer.is_alive()


def test_room_is_waited_for_before_there_is_anything_to_put() -> None:
    queue: BatchQueue[int] = BatchQueue(capacity=1, batch=1, seconds=60.0)
    queue.wait_for_room()
    queue.put(1)
    writer = threading.Thread(target=queue.wait_for_room)
    writer.start()
    writer.join(timeout=0.1)
    assert writer.is_alive()
    queue.fail(OSError("full"))
    writer.join(timeout=30)
    assert not writer.is_alive()


def test_a_writer_who_waits_hears_of_a_failure() -> None:
    queue: BatchQueue[int] = BatchQueue(capacity=1, batch=1, seconds=60.0)
    queue.put(1)
    threading.Timer(0.1, queue.fail, args=(OSError("full"),)).start()
    with pytest.raises(OSError, match="full"):
        queue.put(2)


def test_a_closed_queue_ends_with_an_empty_batch() -> None:
    queue: BatchQueue[int] = BatchQueue(capacity=2, batch=2, seconds=60.0)
    queue.put(1)
    queue.close()
    assert queue.take() == [1]
    assert queue.take() == []
