"""Numbers, names and sizes that no recording of a heart has are refused by every reader, in one sentence."""

import base64
import hashlib
import io
import json
import math
import struct
import tarfile
import tracemalloc
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from dvf_ig.core import DvfIgError, UnreadableFileError
from dvf_ig.intake import read_scenario, write_scenario
from dvf_ig.io import (
    read_calibrations,
    read_feature_points,
    read_image_map,
    read_json,
    read_landmarks,
    read_mesh,
    read_model,
    read_points,
    read_poses,
    read_seeds,
    read_sequence,
    read_surface_series,
    read_transform,
    write_model,
)
from dvf_ig.io.model.model_file import _CHECKSUM, _digest, _unpack
from dvf_ig.io.npz import read_npz
from dvf_ig.io.reading import read_bytes
from dvf_ig.io.yaml_config import read_yaml

FACE = "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
VERTEX = "element vertex 3\nproperty double x\nproperty double y\nproperty double z\n"
PLY = f"ply\nformat ascii 1.0\n{VERTEX}{FACE}"
SEQUENCE = "NDims = 3\nDimSize = 0 0 2\n"
PIXELS = "DimSize = 4 4 4\nElementType = MET_UCHAR\nElementDataFile = "
IDENTITY = "1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"
SHIFT = "Parameters: 1 0 0 0 1 0 0 0 1"
AFFINE = "#Insight Transform File V1.0\n#Transform 0\nTransform: AffineTransform_double_3_3\n"


def frame(stamp: str = "0", pose: str = IDENTITY, number: str = "0000") -> str:
    other = "".join(f"Seq_Frame{i:04d}_Timestamp = {i + 1}\n" for i in range(1, 2))
    return (
        f"{SEQUENCE}Seq_Frame{number}_ToolToTrackerTransform = {pose}\n"
        f"Seq_Frame{number}_Timestamp = {stamp}\n"
        f"{other}ElementDataFile = LOCAL\n"
    )


def tag(kind: str, matrix: str) -> str:
    one = f'<Transform From="Image" To="Probe" Matrix="{matrix}"/>'
    return f"<C><CoordinateDefinitions>{one}{kind}</CoordinateDefinitions></C>"


def transform(path: Path) -> object:
    return read_transform(path, "a", "b")


def landmarks(path: Path) -> object:
    return read_landmarks(path, "mr")


def points(path: Path) -> object:
    return read_points(path, "mr")


CASES: list[tuple[str, str, Callable[[Path], Any], str]] = [
    ("a.ply", PLY + "0 0 0\n1e300 0 0\n0 1 0\n3 0 1 2\n", read_mesh, "check the unit"),
    ("a.ply", PLY + "0 0 0\nnan 0 0\n0 1 0\n3 0 1 2\n", read_mesh, "not finite"),
    ("a.obj", "v 1e300 0 0\nv 0 1 0\nv 0 0 1\nf 1 2 3\n", read_mesh, "check the unit"),
    ("a.fcsv", "# CoordinateSystem = LPS\n1,1e300,0,0,0,0,0,1,1,1,1,F\n", landmarks, "unit"),
    ("p.csv", "1e300,0,0\n", points, "check the unit"),
    ("p.csv", "nan,0,0\n", points, "empty or nan"),
    ("s.json", '{"heart": [[1e300, 0, 0]], "background": [[0, 0, 0]]}', read_seeds, "check the unit"),
    ("t.txt", "1e11 0 0 0 0 0 1\n", read_poses, "check the unit"),
    ("t.txt", "1e11 0 0 0 0 0 0 1\n1e300 0 0 0 0 0 0 1\n", read_poses, "beyond 1e.12; check the unit"),
    ("q.igs.mha", frame(pose=f"1 0 0 1e300{IDENTITY[7:]}"), read_sequence, "check the unit"),
    ("q.igs.mha", frame(stamp="1e300"), read_sequence, "check the unit"),
    ("q.igs.mha", frame(number="9" * 5000), read_sequence, "q.igs.mha"),
    ("q.igs.mha", frame().replace("0 0 2", f"{'9' * 5000} 4 4"), read_sequence, "whole numbers"),
    ("q.igs.mha", f"{PIXELS}/dev/zero\n", read_sequence, "own folder"),
    ("q.igs.mha", f"{PIXELS}../q\n", read_sequence, "own folder"),
    ("q.igs.mha", f"{PIXELS}a\0b\n", read_sequence, "own folder"),
    ("x.xml", tag("", "1e300 0 0 0 0 1e300 0 0 0 0 1 0 0 0 0 1"), read_image_map, "finite numbers up to"),
    ("x.xml", tag("", "nan 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"), read_calibrations, "finite numbers up to"),
    ("f.csv", "frame,column1_px,row1_px\n1000000000,1,2\n", read_feature_points, "not a frame number"),
    ("d.json", "9" * 5000, read_json, "too many digits"),
    ("d.json", "[" * 100_000, read_json, "nested too deeply"),
    (
        "t.tfm",
        f"{AFFINE}Parameters: {{}} 0.2 0 0 0 1 0 0 0 1 0 0 0\nFixedParameters: 0 0 0\n",
        transform,
        "not finite",
    ),
    ("t.tfm", f"{AFFINE}{SHIFT} 5 6 7\n", transform, "cut off"),
    ("t.tfm", f"{AFFINE}{SHIFT} 5 6 7\nFixedParameters: 0 0", transform, "cut off"),
    ("t.tfm", f"{AFFINE}{SHIFT} 1e9 6 7\nFixedParameters: 0 0 0\n", transform, "check the unit"),
    ("t.h5", "\x89HDF\r\n", transform, "not a readable ITK transform"),
]


@pytest.mark.parametrize(
    ("name", "text", "read", "sentence"), CASES, ids=[f"{i}-{c[0]}" for i, c in enumerate(CASES)]
)
def test_refused(tmp_path: Path, name: str, text: str, read: Callable[[Path], Any], sentence: str) -> None:
    path = tmp_path / name
    path.write_bytes(text.encode("latin-1"))
    with pytest.raises(UnreadableFileError, match=sentence) as caught:
        read(path)
    assert "\n" not in str(caught.value)


def test_hdf5_that_itk_cannot_read_ends_its_own_process_alone(tmp_path: Path) -> None:
    (tmp_path / "t.h5").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(range(256)) * 8)
    with pytest.raises(UnreadableFileError, match="not a readable ITK transform"):
        read_transform(tmp_path / "t.h5", "a", "b")


YAMLS = [
    "a: !!timestamp 'zz'",
    "[" * 50_000,
    "a: " + "9" * 5000,
    "a: !!int zz",
    "a: !!binary x",
    "? [1]\n: 2",
    "<<: 3",
]


@pytest.mark.parametrize("text", YAMLS, ids=range(len(YAMLS)))
def test_yaml_that_is_none(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.yaml").write_text(text)
    with pytest.raises(UnreadableFileError, match=r"a\.yaml"):
        read_yaml(tmp_path / "a.yaml", "a configuration")
    (tmp_path / "a.yaml").write_text("day: 2020-13-45")
    assert read_yaml(tmp_path / "a.yaml", "a configuration") == {"day": "2020-13-45"}


@pytest.mark.parametrize("name", ["a\0b", "x" * 300, "/dev/zero", "."])
def test_names_that_are_no_file(tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dvf_ig.io.reading.TEXT_BYTES", 1 << 20)
    with pytest.raises(UnreadableFileError):
        read_bytes(tmp_path / name, "a file")


def vtp(stored: bytes, blocks: int, size: int) -> str:
    head = np.array([blocks, size, 0, *[len(stored)] * min(blocks, 4)], "<u8").tobytes()
    text = base64.b64encode(head).decode() + base64.b64encode(stored * min(blocks, 4)).decode()
    one = f'<DataArray type="Int64" Name="NAME" format="binary">{text}</DataArray>'
    points = one.replace("Int64", "Float64")
    polys = one.replace("NAME", "connectivity") + one.replace("NAME", "offsets")
    return (
        '<VTKFile type="PolyData" byte_order="LittleEndian" header_type="UInt64" '
        'compressor="vtkZLibDataCompressor"><PolyData><Piece NumberOfPoints="1" NumberOfPolys="1">'
        f"<Points>{points}</Points><Polys>{polys}</Polys></Piece></PolyData></VTKFile>"
    )


@pytest.mark.parametrize(
    ("blocks", "size", "sentence"),
    [(1, 1 << 30, "at most"), (1, 100, "does not unpack"), (1 << 40, 1 << 10, "truncated|at most")],
)
def test_arrays_of_a_mesh_that_unpack_to_more(tmp_path: Path, blocks: int, size: int, sentence: str) -> None:
    (tmp_path / "a.vtp").write_text(vtp(zlib.compress(bytes(1 << 24), 9), blocks, size))
    with pytest.raises(UnreadableFileError, match=sentence):
        read_mesh(tmp_path / "a.vtp")


def test_an_archive_of_other_things(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("dvf_ig.io.limits.VOXEL_BYTES", 1 << 16)
    with tarfile.open(tmp_path / "a.tar.gz", "w:gz") as tar:
        member = tarfile.TarInfo("A_0.obj")
        member.size = 1 << 17
        tar.addfile(member, io.BytesIO(bytes(1 << 17)))
    with pytest.raises(UnreadableFileError, match="more than meshes"):
        read_surface_series(tmp_path, "A")


def archive(packed: bool = False, **arrays: Any) -> bytes:
    buffer = io.BytesIO()
    (np.savez_compressed if packed else np.savez)(buffer, **arrays)
    return buffer.getvalue()


def test_arrays_that_unpack_to_more(tmp_path: Path) -> None:
    whole = archive(a=np.eye(3), b=np.zeros((1 << 20), np.uint8))
    assert read_npz(tmp_path, whole, 1 << 21)["a"].tolist() == np.eye(3).tolist()
    with pytest.raises(UnreadableFileError, match="at most"):
        read_npz(tmp_path, whole, 1 << 20)
    with pytest.raises(UnreadableFileError, match="holds an array"):
        read_npz(tmp_path, archive(a=np.array(["text"])), 1 << 21)
    with pytest.raises(UnreadableFileError, match="holds an array"):
        read_npz(tmp_path, archive(a=np.array([Path], dtype=object)), 1 << 21)
    with pytest.raises(UnreadableFileError, match="not a readable archive"):
        read_npz(tmp_path, whole[:-30], 1 << 21)
    damaged = bytearray(whole)
    damaged[60] ^= 0xFF
    with pytest.raises(UnreadableFileError):
        read_npz(tmp_path, bytes(damaged), 1 << 21)


@pytest.mark.parametrize("dtype", ["<f8", ">f4", "<i8", "|b1", "|u1", "<f2", ">u4"])
@pytest.mark.parametrize("shape", [(), (0,), (0, 3), (5,), (2, 3), (1, 2, 1, 3)])
@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_as_numpy_reads_them(tmp_path: Path, dtype: str, shape: tuple[int, ...], order: Any) -> None:
    data = archive(a=np.asarray(np.arange(math.prod(shape)).reshape(shape), dtype, order=order))
    with np.load(io.BytesIO(data)) as loaded:
        expected = loaded["a"]
    found = read_npz(tmp_path, data, 1 << 20)["a"]
    assert (found.dtype, found.shape) == (expected.dtype, expected.shape)
    np.testing.assert_array_equal(found, expected)


def peak_of(read: Callable[[], object]) -> int:
    """The most bytes of Python's and numpy's memory that were in use while something was refused."""
    tracemalloc.start()
    try:
        with pytest.raises(UnreadableFileError):
            read()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_small_archive_that_states_much_takes_no_memory(tmp_path: Path) -> None:
    packed = archive(packed=True, a=np.zeros(1 << 28, np.uint8))
    assert len(packed) < 1 << 19
    assert peak_of(lambda: read_npz(tmp_path, packed, 2 << 30)) < 1 << 20
    plain = archive(a=np.zeros(1 << 16, np.uint8))
    end = plain.rindex(b"PK\x01\x02")
    many = zipfile.ZipFile(io.BytesIO(plain)).infolist()[0]
    entry = plain[end : plain.rindex(b"PK\x05\x06")]
    count = 900
    tail = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, count, count, count * len(entry), end, 0)
    assert many.file_size > 1 << 16
    overlapping = plain[:end] + count * entry + tail
    assert peak_of(lambda: read_npz(tmp_path, overlapping, 2 << 30)) < 4 << 20


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000000, 1000000000000000000), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (0, 1000000000000000000), }",
        f"{{'descr': '<f8', 'fortran_order': False, 'shape': (0, {'9' * 400}), }}",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1e400,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (-1,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': None, }",
        "{'descr': '<f99', 'fortran_order': False, 'shape': (1,), }",
        "{'descr': ('<f8', (1000000000,)), 'fortran_order': False, 'shape': (), }",
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }",
        "{'descr': [('a', '<f8')], 'fortran_order': False, 'shape': (1,), }",
        "{'descr': '<f8', 'fortran_order': False, 'shape': (1,), 'shape': (2,), }",
        "(" * 3000,
        "",
    ],
)
def test_headers_of_arrays(tmp_path: Path, header: str) -> None:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as zipped:
        text = header.encode() + b"\n"
        zipped.writestr("a.npy", b"\x93NUMPY\x01\x00" + struct.pack("<H", len(text)) + text + bytes(8))
    with pytest.raises(UnreadableFileError, match="holds an array that is damaged"):
        read_npz(tmp_path, buffer.getvalue(), 1 << 21)


CHANGES: list[tuple[dict[str, Any], dict[str, Any], str]] = [
    ({"axes": "RAS"}, {}, "axes"),
    ({"units": {"length": "m", "time": "s", "coefficients": "mm"}}, {}, "units.length"),
    ({"ed_phase": 999}, {}, "ed_phase is 999"),
    ({"ed_phase": "0"}, {}, "ed_phase"),
    ({"rr_s": "1"}, {}, "rr_s"),
    ({"rr_s": None}, {}, "rr_s"),
    ({"knot_spacing_mm": float("nan")}, {}, "knot_spacing_mm"),
    ({"knot_spacing_mm": 0.0}, {}, "knot_spacing_mm"),
    ({"sources": "abc"}, {}, "sources"),
    ({"frame": "Mr!"}, {}, "frame"),
    ({"phases": 3}, {}, "states 3 phases"),
    ({"patient_id": 7}, {}, "patient_id"),
    ({"chambers": ["lv"]}, {}, "lacks"),
    ({"es_fraction": 7.0}, {}, "es_fraction"),
    ({}, {"origin_mm": np.array([np.nan, 0, 0])}, "origin_mm are not all finite"),
    ({}, {"origin_mm": np.array([1e300, 0, 0])}, "check the unit"),
    ({}, {"coefficients": np.full((4, 33, 33, 33), np.nan, np.float32)}, "not all finite"),
    ({}, {"vertex_counts": np.array([-1, 1])}, "do not count|vertex_counts"),
    ({}, {"triangle_counts": np.array([1.5, 1.5])}, "do not count|triangle_counts"),
    ({}, {"reference_triangles": np.array([[0, 1, 10**6]] * 10, np.int32)}, "do not match|refers to vertex"),
]


@pytest.mark.parametrize(("header", "arrays", "sentence"), CHANGES, ids=range(len(CHANGES)))
def test_a_model_sealed_again_with_other_values(
    tmp_path: Path, ball: Any, header: dict[str, Any], arrays: dict[str, Any], sentence: str
) -> None:
    """Checksums show what changed by chance; what somebody sealed again is held against itself."""
    write_model(ball, tmp_path / "m.npz")
    found, kept = _unpack(tmp_path / "m.npz", (tmp_path / "m.npz").read_bytes())
    found.pop("sha256")
    found, kept = found | header, kept | arrays
    found["sha256"] = _digest(found, kept)
    buffer = io.BytesIO()
    text = np.frombuffer(json.dumps(found).encode(), np.uint8)
    np.savez(buffer, **{"header": text, **kept})
    data = buffer.getvalue()[:-2] + (len(_CHECKSUM) + 64).to_bytes(2, "little") + _CHECKSUM
    (tmp_path / "m.npz").write_bytes(data + hashlib.sha256(data).hexdigest().encode())
    with pytest.raises(DvfIgError, match=sentence):
        read_model(tmp_path / "m.npz")


@pytest.mark.parametrize(
    "name", ["../outside.csv", "/etc/passwd", "a/../../b", "csv:/etc/passwd", "wfdb:../x"]
)
def test_a_scenario_names_files_of_its_own_alone(tmp_path: Path, make_scenario: Any, name: str) -> None:
    write_scenario(make_scenario(1), tmp_path / "s")
    config = tmp_path / "s" / "scenario.yaml"
    config.write_text(config.read_text().replace("ecg: ecg.csv", f"ecg: {name}"))
    with pytest.raises(UnreadableFileError, match="in its own folder"):
        read_scenario(tmp_path / "s")
