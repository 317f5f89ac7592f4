"""Messages that are wrong, by the ten thousand: what the decoder and a connection make of them.

Valid messages of every type are damaged (bits, lengths, counts, cut, joined) with or without a checksum that
fits, and fed in pieces of any size. Every one must end in a message or a `WireError`, soon, in bounded
memory.
"""

import struct
import time
import tracemalloc
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from dvf_ig.core import FloatArray
from dvf_ig.live.igtl import (
    Image,
    Incoming,
    Message,
    Status,
    Text,
    TrackedTool,
    TrackingData,
    Transform,
    WireError,
    decode,
    encode,
)
from dvf_ig.live.igtl.codec import HEADER_BYTES, checksum

HANG_S = 0.05
_SIZE_AT, _CRC_AT = 42, 50
_INTERESTING = (0, 1, 0x7F, 0x80, 0xFF, 0x7FFF, 0x8000, 0xFFFF, 0x7FFFFFFF, 0xFFFFFFFF, (1 << 64) - 1)


@dataclass(slots=True)
class WrongMessages:
    """What came of them.

    Attributes:
        messages: fed; `accepted` were messages after all.
        refused: by problem.
        foreign: exceptions that are no `WireError`, by type; there should be none.
        hangs: messages that took more computing time than HANG_S, `slowest_s` the longest.
        peak_bytes: memory that was held at the most.
    """

    messages: int = 0
    accepted: int = 0
    refused: Counter[str] = field(default_factory=Counter)
    foreign: Counter[str] = field(default_factory=Counter)
    hangs: int = 0
    slowest_s: float = 0.0
    peak_bytes: int = 0

    @property
    def clean(self) -> bool:
        return not self.foreign and not self.hangs


def feed_wrong_messages(count: int, seed: int, *, memory: bool = False) -> WrongMessages:
    """Damage and feed so many messages.

    Args:
        memory: measure what is held, which makes everything ten times slower.
    """
    for message in samples():  # what is loaded or compiled at a first use is none of a message's time
        decode(encode(message)[:HEADER_BYTES], encode(message)[HEADER_BYTES:])
    rng, found, incoming = np.random.default_rng(seed), WrongMessages(), Incoming()
    damaged = damaged_messages(count, rng)
    if memory:
        tracemalloc.start()
    for data in damaged:
        begun_s = time.thread_time()
        incoming = _feed(data, incoming, found, rng)
        spent_s = time.thread_time() - begun_s
        found.messages += 1
        found.slowest_s = max(found.slowest_s, spent_s)
        found.hangs += spent_s > HANG_S
    if memory:
        found.peak_bytes = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
    return found


def damaged_messages(count: int, rng: np.random.Generator) -> Iterator[bytes]:
    """So many messages, each damaged in one to three places."""
    whole = [encode(message) for message in samples()]
    return (_damaged(whole[rng.integers(len(whole))], rng) for _ in range(count))


def samples() -> tuple[Message, ...]:
    """A valid message of every type that is read, and some that are passed over."""
    pose = np.eye(4)
    pose[:3, 3] = 12.5, -7.0, 99.0
    fields = MappingProxyType({"TransformStatus": "OK", "EcgData": "0.1 0.2 0.3", "EcgDataTimestamp": "12.5"})
    pixels = np.arange(48, dtype=np.uint8).reshape(1, 6, 8)
    tools = (TrackedTool("ProbeToTracker", pose), TrackedTool("ToolToTracker", pose))
    return (
        Message("ProbeToTracker", 12.5, Transform(pose)),
        Message("ProbeToTracker", 12.5, Transform(pose), fields),
        Message("Image_Tracker", 12.5, Image(pixels, pose)),
        Message("Image_Tracker", 12.5, Image(pixels.astype(np.float32), pose, lps=True), fields),
        Message("TDATA_2Elem", 12.5, TrackingData(tools), fields),
        Message("EcgData", 12.5, Text("0.1 0.2 0.3"), fields),
        Message("PLUS", None, Status(1, 0, "", "fine")),
    )


def _feed(data: bytes, incoming: Incoming, found: WrongMessages, rng: np.random.Generator) -> Incoming:
    """One damaged message to the pure decoder and, in pieces, to a connection's; the latter, or a new one."""
    try:
        _count(decode(data[:HEADER_BYTES], data[HEADER_BYTES:]) if len(data) >= HEADER_BYTES else None, found)
    except WireError as error:
        _count(error, found)
    except Exception as error:  # noqa: BLE001  what this looks for
        found.foreign[type(error).__name__] += 1
    try:
        for piece in _pieces(data, rng):
            incoming.feed(piece)
    except WireError:
        return Incoming()
    except Exception as error:  # noqa: BLE001
        found.foreign[type(error).__name__] += 1
        return Incoming()
    return incoming if rng.random() < 0.9 else Incoming()


def _count(taken: Message | WireError | None, found: WrongMessages) -> None:
    if isinstance(taken, WireError):
        found.refused[taken.problem.name] += 1
    elif taken is not None:
        found.accepted += 1


def _pieces(data: bytes, rng: np.random.Generator) -> list[bytes]:
    cuts = np.sort(rng.integers(0, len(data) + 1, int(rng.integers(0, 4)))).tolist()
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


def _damaged(data: bytes, rng: np.random.Generator) -> bytes:
    out = bytearray(data)
    for _ in range(int(rng.integers(1, 4))):
        _damage(out, rng)
    if rng.random() < 0.7 and len(out) >= HEADER_BYTES:
        if rng.random() < 0.8:
            out[_SIZE_AT:_CRC_AT] = struct.pack(">Q", len(out) - HEADER_BYTES)
        out[_CRC_AT:HEADER_BYTES] = struct.pack(">Q", checksum(bytes(out[HEADER_BYTES:])))
    return bytes(out)


def _damage(out: bytearray, rng: np.random.Generator) -> None:
    """One change, in place."""
    if not out:
        return
    at, kind = int(rng.integers(len(out))), rng.integers(6)
    if kind == 0:
        out[at] ^= 1 << int(rng.integers(8))
    elif kind == 1:
        size = int(rng.choice((1, 2, 4, 8)))
        value = int(_INTERESTING[rng.integers(len(_INTERESTING))]) & ((1 << 8 * size) - 1)
        out[at : at + size] = value.to_bytes(size, "big")
    elif kind == 2:
        del out[at:]
    elif kind == 3:
        out[at:at] = rng.bytes(int(rng.integers(1, 64)))
    elif kind == 4:
        del out[at : at + int(rng.integers(1, 16))]
    else:
        out[at : at + 4] = struct.pack(">f", float(rng.choice(_FLOATS)))


_FLOATS: FloatArray = np.array([np.nan, np.inf, -np.inf, 1e38, 0.0, -1.0, 1e-40])
