"""Memory shared without locks: no torn value, no lost row that is not reported."""

import threading

import numpy as np

from dvf_ig.kernels.compiled import kernel
from dvf_ig.kernels.servo import loop
from dvf_ig.kernels.servo.shared import new_counter, publish, read_shared
from dvf_ig.kernels.servo.tick import ROW

WRITES = 200_000


@kernel
def write_many(counter, shared, values, count):
    for k in range(count):
        values[:] = k
        publish(counter, shared, values)


@kernel
def read_until(counter, shared, out, work, last):
    """Reads, torn values and values that went back, until the last value is seen."""
    seen, reads, torn, back, before = -1, 0, 0, 0, -1.0
    while before < last:
        seen = read_shared(counter, shared, seen, out, work)
        for i in range(len(out)):
            torn += out[i] != out[0]
        back += out[0] < before
        before = out[0]
        reads += 1
    return reads, torn, back


def test_a_sequence_lock_never_gives_a_torn_value():
    counter, shared = new_counter(), np.zeros(113)
    out, work = np.full(113, -1.0), np.zeros(113)
    write_many(new_counter(), np.zeros(113), np.zeros(113), 1)
    publish(counter, shared, np.zeros(113))
    read_until(counter, shared, out, work, 0.0)
    writer = threading.Thread(target=write_many, args=(counter, shared, np.zeros(113), WRITES))
    writer.start()
    reads, torn, back = read_until(counter, shared, out, work, WRITES - 1.0)
    writer.join()
    assert torn == back == 0
    assert reads > 1


def test_a_reader_keeps_what_it_has_while_a_writer_is_in_the_middle():
    counter, shared, out = new_counter(), np.full(3, 7.0), np.full(3, 5.0)
    counter[0] = 3
    assert read_shared(counter, shared, 2, out, np.zeros(3)) == 2
    np.testing.assert_array_equal(out, 5.0)


def test_a_ring_that_was_overwritten_says_so():
    ring, numbers = np.zeros((8, ROW)), np.zeros(loop.NUMBERS, dtype=np.int64)
    for k in range(20):
        loop.record_row(ring, numbers, np.full(ROW, float(k)))
    out = np.empty((3, ROW))
    assert loop.copy_rows(ring, numbers, 17, out) == 20
    np.testing.assert_array_equal(out, np.arange(17.0, 20.0)[:, None] * np.ones(ROW))
    assert loop.copy_rows(ring, numbers, 11, out) == 14
    assert np.isnan(out[:2]).all()
    np.testing.assert_array_equal(out[2], 13.0)
