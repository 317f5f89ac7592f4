"""A stream of bytes taken apart, whatever the pieces; and fifty thousand wrong messages in small."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from wrong_messages import feed_wrong_messages, samples

from dvf_ig.live.igtl import Ignored, Incoming, Message, Text, Transform, WireError, WireProblem, encode
from dvf_ig.live.igtl.codec import encode_header

STREAM = b"".join(encode(message) for message in samples())


@given(st.lists(st.integers(1, 400), min_size=1, max_size=30))
def test_pieces_do_not_matter(sizes):
    incoming, found, at = Incoming(), [], 0
    for size in [*sizes, len(STREAM)]:
        found += incoming.feed(STREAM[at : at + size])
        at += size
    assert [type(m.content) for m in found if isinstance(m, Message)] == [type(m.content) for m in samples()]
    assert not incoming.within_message
    incoming.close()


def test_what_follows_a_refused_message_is_read():
    bad = bytearray(encode(Message("T", 1.0, Transform(np.eye(4)))))
    bad[-1] ^= 1
    found = Incoming().feed(bytes(bad) + STREAM)
    assert isinstance(found[0], WireError)
    assert found[0].problem is WireProblem.CHECKSUM
    assert found[0].device == "T"
    assert len(found) == 1 + len(samples())


def test_long_bodies_that_nobody_reads_are_not_kept():
    incoming, size = Incoming(), 1 << 20
    header = bytearray(encode_header("POLYDATA", "x", 1.0, b"", 1))
    header[42:50] = size.to_bytes(8, "big")
    assert incoming.feed(bytes(header)) == [Message("x", 1.0, Ignored("POLYDATA"))]
    for _ in range(16):
        assert incoming.within_message
        incoming.feed(bytes(size // 16))
        assert len(incoming._buffer) == 0
    after = incoming.feed(encode(Message("x", 1.0, Text("next"))))
    assert after == [Message("x", 1.0, Text("next"))]


def test_closing_within_a_message_is_told():
    incoming = Incoming()
    incoming.feed(STREAM[:100])
    incoming.feed(b"")
    whole = Incoming()
    whole.feed(STREAM[: 58 + 48 + 20])
    with pytest.raises(WireError) as caught:
        whole.close()
    assert caught.value.problem is WireProblem.CLOSED


def test_wrong_messages_end_in_a_message_or_a_refusal():
    found = feed_wrong_messages(2000, seed=7)
    assert not found.foreign, found
    assert found.messages == 2000
    assert found.accepted > 100
    assert {"SIZE", "CHECKSUM", "VALUE", "NOT_FINITE", "TOO_LARGE"} <= set(found.refused)


def test_wrong_messages_hold_no_memory():
    assert feed_wrong_messages(300, seed=8, memory=True).peak_bytes < 2 << 20
