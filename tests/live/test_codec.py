"""OpenIGTLink messages to bytes and back: ours, another implementation's, and what must be refused."""

import struct
from types import MappingProxyType

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.io import limits
from dvf_ig.kernels.crc64 import TABLES, crc64_of, crc64_readable
from dvf_ig.live.igtl import (
    Ignored,
    Image,
    Message,
    Status,
    Text,
    TrackedTool,
    TrackingData,
    Transform,
    WireError,
    WireProblem,
    decode,
    encode,
)
from dvf_ig.live.igtl.codec import HEADER_BYTES, checksum, decode_header, encode_header

pyigtl = pytest.importorskip("pyigtl")

POSE = np.array([[0.0, -1.0, 0.0, 12.5], [1.0, 0.0, 0.0, -7.0], [0.0, 0.0, 1.0, 99.0], [0.0, 0.0, 0.0, 1.0]])
FIELDS = MappingProxyType({"TransformStatus": "OK", "Größe": "3 µm"})


def taken(data: bytes) -> Message:
    return decode(data[:HEADER_BYTES], data[HEADER_BYTES:])


def sealed(kind: str, body: bytes, version: int = 1) -> bytes:
    """A message whose header is right whatever its body holds."""
    return encode_header(kind, "x", 1.0, body, version) + body


def problem(data: bytes) -> WireProblem:
    with pytest.raises(WireError) as caught:
        taken(data)
    return caught.value.problem


def test_known_checksum():
    """CRC-64/ECMA-182 of the digits, as its registry gives it."""
    assert crc64_readable(b"123456789") == 0x6C40DF5F0B497347
    assert crc64_readable(b"") == 0


@given(st.binary(min_size=1, max_size=70))
def test_checksum_kernel_is_its_readable_form(data):
    assert int(crc64_of(np.frombuffer(data, dtype=np.uint8), TABLES)) == crc64_readable(data)


@pytest.mark.parametrize("fields", [MappingProxyType({}), FIELDS])
def test_transform_comes_back(fields):
    back = taken(encode(Message("ProbeToTracker", 12.25, Transform(POSE), fields)))
    assert (back.device, back.stamp_s, back.fields) == ("ProbeToTracker", 12.25, fields)
    assert isinstance(back.content, Transform)
    np.testing.assert_array_equal(back.content.matrix, POSE)


def test_known_shift_in_bytes():
    """The protocol's own layout: columns of the rotation, then the translation, big-endian float32."""
    body = encode(Message("T", 1.0, Transform(POSE)))[HEADER_BYTES:]
    assert struct.unpack(">12f", body) == (0, 1, 0, -1, 0, 0, 0, 0, 1, 12.5, -7, 99)


def test_image_place_is_that_of_the_first_pixel():
    """On the wire stands the centre: of 4 x 3 pixels of 0.5 mm, 0.75 and 0.5 mm from the first pixel."""
    matrix = np.diag([0.5, 0.5, 1.0, 1.0])
    matrix[:3, 3] = 10.0, 20.0, 30.0
    data = encode(Message("Image", 1.0, Image(np.zeros((1, 3, 4), dtype=np.uint8), matrix)))
    assert struct.unpack_from(">3f", data, HEADER_BYTES + 12 + 36) == (10.75, 20.5, 30.0)
    back = taken(data).content
    assert isinstance(back, Image)
    np.testing.assert_allclose(back.matrix, matrix, atol=1e-6)


@pytest.mark.parametrize("kind", ["u1", "i1", "u2", "i2", "u4", "i4", "f4", "f8"])
@pytest.mark.parametrize("shape", [(1, 3, 5), (2, 3, 5, 3)])
def test_image_of_every_type_comes_back(kind, shape):
    pixels = np.arange(np.prod(shape)).reshape(shape).astype(kind)
    back = taken(encode(Message("Image", 1.0, Image(pixels, np.eye(4), lps=True)))).content
    assert isinstance(back, Image)
    assert back.lps
    assert back.pixels.dtype == pixels.dtype
    np.testing.assert_array_equal(back.pixels, pixels)


def test_tools_status_and_text_come_back():
    tools = TrackingData((TrackedTool("ProbeToTracker", POSE), TrackedTool("ToolToTracker", np.eye(4))))
    back = taken(encode(Message("TDATA", 3.0, tools))).content
    assert isinstance(back, TrackingData)
    assert [tool.name for tool in back.tools] == ["ProbeToTracker", "ToolToTracker"]
    np.testing.assert_array_equal(back.tools[0].matrix, POSE)
    for content in (Status(13, -5, "FADE", "the tool is lost"), Text("1.5 2.5"), Text("µV"), Text("")):
        assert taken(encode(Message("x", None, content))) == Message("x", None, content)


@pytest.mark.parametrize(
    ("numbers", "kind"),
    [((1, 2, 3), "POSITION"), ((1, 2, 3, 0, 0, 0.6), "POSITION"), ((1, 2, 3, 0, 0, 0.6, 0.8), "QTRANS")],
)
def test_positions_are_read_as_transforms(numbers, kind):
    content = taken(sealed(kind, struct.pack(f">{len(numbers)}f", *numbers))).content
    assert isinstance(content, Transform)
    np.testing.assert_allclose(content.matrix[:3, 3], (1, 2, 3))
    turned = (0.28, 0.96) if len(numbers) > 3 else (1.0, 0.0)
    np.testing.assert_allclose(content.matrix[:2, 0], turned, atol=1e-6)


def test_quaternion_tools_are_read():
    tool = struct.pack(">20sBB7f", b"Tool", 3, 0, 1, 2, 3, 0, 0, 0.6, 0.8)
    content = taken(sealed("QTDATA", tool)).content
    assert isinstance(content, TrackingData)
    assert content.tools[0].name == "Tool"
    np.testing.assert_allclose(content.tools[0].matrix[:2, 0], (0.28, 0.96), atol=1e-6)


def test_what_nobody_uses_is_passed_over():
    for kind in ("GET_TRANS", "STT_TDATA", "STP_TDATA", "POLYDATA", "CAPABILITY"):
        assert taken(sealed(kind, b"abc")).content == Ignored(kind)


# ------------------------------------------------------------------ another implementation


def test_other_implementation_reads_ours():
    message = Message("ProbeToTracker", 12.25, Transform(POSE), MappingProxyType({"TransformStatus": "OK"}))
    data = encode(message)
    header = pyigtl.messages.MessageBase.parse_header(data[:HEADER_BYTES])
    theirs = pyigtl.messages.MessageBase.create_message(header["message_type"])
    theirs.unpack(header, data[HEADER_BYTES:])
    np.testing.assert_allclose(theirs.matrix, POSE)
    assert (theirs.device_name, theirs.timestamp) == ("ProbeToTracker", 12.25)
    assert theirs.metadata == {"TransformStatus": "OK"}


def test_theirs_is_read_here():
    theirs = pyigtl.TransformMessage(POSE, device_name="ProbeToTracker", timestamp=12.25)
    assert encode(Message("ProbeToTracker", 12.25, Transform(POSE))) == theirs.pack()
    pixels = np.arange(24, dtype=np.uint8).reshape(1, 4, 6)
    image = taken(pyigtl.ImageMessage(pixels, device_name="Image_Tracker").pack()).content
    assert isinstance(image, Image)
    np.testing.assert_array_equal(image.pixels, pixels)
    assert taken(pyigtl.StringMessage("0.1 0.2", device_name="EcgData").pack()).content == Text("0.1 0.2")


# ------------------------------------------------------------------ refusals


def test_one_wrong_bit_fails_the_checksum():
    data = bytearray(encode(Message("T", 1.0, Transform(POSE))))
    data[-1] ^= 1
    assert problem(bytes(data)) is WireProblem.CHECKSUM


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_numbers_that_are_not_finite_are_refused(bad):
    matrix = POSE.copy()
    matrix[0, 3] = bad
    assert problem(encode(Message("T", 1.0, Transform(matrix)))) is WireProblem.NOT_FINITE
    assert problem(sealed("POSITION", struct.pack(">3f", 1, bad, 3))) is WireProblem.NOT_FINITE
    body = bytearray(
        encode(Message("I", 1.0, Image(np.zeros((1, 2, 2), np.uint8), np.eye(4))))[HEADER_BYTES:]
    )
    body[12:16] = struct.pack(">f", bad)
    assert problem(sealed("IMAGE", bytes(body))) is WireProblem.NOT_FINITE


@pytest.mark.parametrize("matrix", [2.0 * POSE, np.diag([1.0, 1.0, -1.0, 1.0]), POSE + 1e-2])
def test_matrices_that_are_not_rigid_are_refused(matrix):
    assert problem(encode(Message("T", 1.0, Transform(matrix)))) is WireProblem.NOT_RIGID


def test_translation_beyond_a_kilometre_is_refused():
    matrix = np.eye(4)
    matrix[0, 3] = 1.1 * limits.LENGTH_MM
    assert problem(encode(Message("T", 1.0, Transform(matrix)))) is WireProblem.NOT_RIGID


@pytest.mark.parametrize(
    ("kind", "body"),
    [
        ("TRANSFORM", bytes(47)),
        ("TDATA", bytes(71)),
        ("QTDATA", bytes(51)),
        ("POSITION", bytes(16)),
        ("STRING", struct.pack(">HH", 3, 5) + b"four"),
        ("STATUS", bytes(29)),
        ("IMAGE", bytes(20)),
    ],
)
def test_sizes_that_do_not_fit_are_refused(kind, body):
    assert problem(sealed(kind, body)) is WireProblem.SIZE


def test_image_sizes_that_contradict_each_other_are_refused():
    body = bytearray(
        encode(Message("I", 1.0, Image(np.zeros((1, 2, 2), np.uint8), np.eye(4))))[HEADER_BYTES:]
    )
    for at, size in ((6, (3, 2, 1)), (6, (0, 2, 1)), (60, (1, 0, 0)), (66, (1, 2, 1)), (6, (65535,) * 3)):
        wrong = body.copy()
        wrong[at : at + 6] = struct.pack(">3H", *size)
        assert problem(sealed("IMAGE", bytes(wrong))) is WireProblem.SIZE


@pytest.mark.parametrize(
    ("kind", "size"),
    [("TRANSFORM", 49), ("IMAGE", 1 << 63), ("STRING", 1 << 20), ("POLYDATA", 1 << 40), ("TDATA", 70 * 129)],
)
def test_stated_size_is_refused_before_it_is_reserved(kind, size):
    header = bytearray(encode_header(kind, "x", 1.0, b"", 1))
    header[42:50] = struct.pack(">Q", size)
    with pytest.raises(WireError) as caught:
        decode_header(bytes(header))
    assert caught.value.problem is WireProblem.TOO_LARGE


@pytest.mark.parametrize(
    ("at", "value", "expected"),
    [(0, b"\0\4", WireProblem.VERSION), (2, b"\xff", WireProblem.NAME), (2, b"\0", WireProblem.NAME)],
)
def test_headers_that_are_none_are_refused(at, value, expected):
    data = bytearray(encode(Message("T", 1.0, Transform(POSE))))
    data[at : at + len(value)] = value
    assert problem(bytes(data)) is expected


@pytest.mark.parametrize("change", [(58, 13), (58, 500), (60, 3), (62, 1000)])
def test_extended_headers_that_do_not_fit_are_refused(change):
    at, value = change
    data = bytearray(encode(Message("T", 1.0, Transform(POSE), FIELDS)))
    data[at : at + 2] = struct.pack(">H", value)
    data[50:58] = struct.pack(">Q", checksum(bytes(data[58:])))
    assert problem(bytes(data)) is WireProblem.SIZE


@settings(max_examples=300)
@given(
    st.binary(max_size=200), st.sampled_from(["TRANSFORM", "IMAGE", "TDATA", "STRING", "STATUS", "QTDATA"])
)
def test_any_body_is_a_message_or_refused(body, kind):
    for version in (1, 2):
        try:
            taken(encode_header(kind, "x", 1.0, body, version) + body)
        except WireError as error:
            assert error.kind == kind  # noqa: PT017
