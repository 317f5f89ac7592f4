"""Memory shared without locks: no torn value, no lost row that is not reported."""

import threading

import numpy as np

from dvf_ig.kernels.compiled import kernel
from dvf_ig.kernels.servo import loop
from dvf_ig.kernels.servo.layout import ROW_WORDS
from dvf_ig.kernels.servo.shared import load_ordered, new_counter, publish, read_shared, store_number

READS = 400
PAUSE = 10_000
"""Steps of the writer between two values: longer than a write takes, so that most reads find it outside."""


@kernel
def write_until_stopped(counter, shared, values, stop):
    k = 0.0
    while load_ordered(stop, 0) == 0:
        k += 1.0
        values[:] = k
        publish(counter, shared, values)
        for _ in range(PAUSE):
            if load_ordered(stop, 0) != 0:
                break


@kernel
def read_many(counter, shared, out, work, count):
    """Torn values, and values that went back, among so many reads that found something new."""
    seen, reads, torn, back, before = -1, 0, 0, 0, -1.0
    while reads < count:
        count_before = seen
        seen = read_shared(counter, shared, seen, out, work, len(out), 0)
        reads += seen != count_before
        for i in range(len(out)):
            torn += out[i] != out[0]
        back += out[0] < before
        before = out[0]
    return torn, back


def test_a_sequence_lock_never_gives_a_torn_value():
    counter, shared, stop = new_counter(), np.zeros(113), np.ones(1, dtype=np.int64)
    out, work = np.full(113, -1.0), np.zeros(113)
    write_until_stopped(counter, shared, np.zeros(113), stop)
    assert read_many(counter, shared, out, work, 1) == (0, 0)
    stop[0] = 0
    writer = threading.Thread(target=write_until_stopped, args=(counter, shared, np.zeros(113), stop))
    writer.start()
    found = read_many(counter, shared, out, work, READS)
    store_number(stop, 0, 1)
    writer.join()
    assert found == (0, 0)
    assert out[0] >= READS - 1


def test_a_reader_keeps_what_it_has_while_a_writer_is_in_the_middle():
    counter, shared, out = new_counter(), np.full(3, 7.0), np.full(3, 5.0)
    counter[0] = 3
    assert read_shared(counter, shared, 2, out, np.zeros(3), 3, 0) == 2
    np.testing.assert_array_equal(out, 5.0)


def test_what_follows_the_head_is_read_where_its_number_has_changed():
    counter, shared, out = new_counter(), np.zeros(4), np.zeros(4)
    publish(counter, shared, np.array([1.0, 0.0, 7.0, 8.0]))
    seen = read_shared(counter, shared, -1, out, np.zeros(4), 2, 1)
    np.testing.assert_array_equal(out, [1.0, 0.0, 0.0, 0.0])
    publish(counter, shared, np.array([2.0, 1.0]))
    read_shared(counter, shared, seen, out, np.zeros(4), 2, 1)
    np.testing.assert_array_equal(out, [2.0, 1.0, 7.0, 8.0])


def test_a_ring_that_was_overwritten_says_so():
    ring, numbers = np.zeros((8, ROW_WORDS), dtype=np.int64), np.zeros(loop.NUMBERS, dtype=np.int64)
    for k in range(20):
        loop.record_row(ring, numbers, np.full(ROW_WORDS, k))
    out = np.empty((3, ROW_WORDS), dtype=np.int64)
    assert loop.copy_rows(ring, numbers, 17, out) == 20
    np.testing.assert_array_equal(out, np.arange(17, 20)[:, None] * np.ones(ROW_WORDS))
    assert loop.copy_rows(ring, numbers, 11, out) == 14
    assert np.isnan(out[:2].view(np.float64)).all()
    np.testing.assert_array_equal(out[2], 13)
