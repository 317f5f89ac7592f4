"""The model file: exact, tamper-evident, and never another patient's by mistake."""

import io
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from dvf_ig.core import (
    Chamber,
    CycleTiming,
    DvfModel,
    Grid,
    InvalidInputError,
    Mesh,
    SeenPart,
    Tissue,
    UnreadableFileError,
    Volume,
    Warp,
)
from dvf_ig.io import model_digest, read_model, write_model

Same = Callable[..., None]


def model(seed: int = 0, patient: str = "patient-1") -> DvfModel:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    seen = SeenPart(
        [0.0, 0.6, 0.8], np.tile([[-9.0, 4.0], [7.0, 10.0]], (n, 1, 1)), [-1.0, 2.0], rng.random(n)
    )
    meshes = tuple(
        Mesh("mr", rng.normal(size=(v, 3)) * 40, rng.integers(0, v, (int(rng.integers(1, 9)), 3)))
        for v in rng.integers(3, 12, n).tolist()
    )
    return DvfModel(
        patient_id=patient,
        surface_name="EPICARDIAL",
        frame="mr",
        timing=CycleTiming(np.sort(rng.random(n)), 0.8288, rr_assumed=bool(seed % 2)),
        es_fraction=0.36,
        ed_phase=0,
        coefficients=rng.normal(size=(n, 5, 4, 6)).astype(np.float32),
        origin_mm=rng.normal(size=3) * 100,
        knot_spacing_mm=3.3,
        reference=meshes,
        reference_caps=tuple(rng.random(len(m.triangles)) > 0.5 for m in meshes),
        sources=("surfaces", "Zürich"),
        chambers=tuple(chamber(rng, name, n) for name in ("lv_blood", "label 3")[: int(rng.integers(0, 3))]),
        seen=seen if seed % 3 == 1 else None,
        tissue=tissue(rng, n) if seed % 2 else None,
    )


def tissue(rng: np.random.Generator, phases: int) -> Tissue:
    labels = Volume(
        Grid.axis_aligned("mr", (4, 3, 5), rng.normal(size=3), 1.5), rng.integers(0, 4, (4, 3, 5), np.uint8)
    )
    motion = rng.normal(size=(phases, 15, 15, 15, 4)).astype(np.float32)
    warps = tuple(Warp("mr", np.array([1.0, -2.0, 3.0]), 11.5, one) for one in motion)
    return Tissue(labels, ((1, "wall"), (3, "Höhle")), warps)


def chamber(rng: np.random.Generator, name: str, phases: int) -> Chamber:
    """The triangles of some phases are those of the phase before."""
    triangles, surfaces = rng.integers(0, 5, (4, 3)), []
    for _ in range(phases):
        if rng.random() < 0.5:
            triangles = rng.integers(0, 5, (int(rng.integers(1, 6)), 3))
        surfaces.append(Mesh("mr", rng.normal(size=(5, 3)) * 40, triangles))
    return Chamber(name, tuple(surfaces))


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32))
def test_round_trip_is_exact(tmp_path_factory: pytest.TempPathFactory, assert_same: Same, seed: int) -> None:
    path = tmp_path_factory.mktemp("case") / "m.npz"
    write_model(model(seed), path)
    back = read_model(path, "patient-1")
    assert_same(back, model(seed))
    assert model_digest(back) == model_digest(model(seed))


def test_a_file_without_chambers_is_that_of_versions_that_kept_none(tmp_path: Path) -> None:
    write_model(replace(model(3), chambers=()), tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz", allow_pickle=False) as archive:
        assert not [name for name in archive.files if "chamber" in name]
        assert "chambers" not in json.loads(archive["header"].tobytes())
    assert read_model(tmp_path / "m.npz").chambers == ()


def test_a_file_without_tissue_is_that_of_versions_that_kept_none(tmp_path: Path) -> None:
    write_model(replace(model(3), tissue=None), tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz", allow_pickle=False) as archive:
        assert not [name for name in archive.files if "tissue" in name]
        assert "tissue" not in json.loads(archive["header"].tobytes())
    assert read_model(tmp_path / "m.npz").tissue is None


def test_a_file_says_whether_it_holds_a_part(tmp_path: Path) -> None:
    """Whole models keep their schema; readers before this one refuse a part by its schema."""
    for seed, schema, arrays in ((3, "dvf_ig.model/1", 0), (4, "dvf_ig.model/2", 4)):
        write_model(model(seed), tmp_path / f"{seed}.npz")
        with np.load(tmp_path / f"{seed}.npz", allow_pickle=False) as archive:
            assert json.loads(archive["header"].tobytes())["schema"] == schema
            assert sum(name.startswith("seen") for name in archive.files) == arrays


def test_chambers_that_move_with_their_vertices_take_12_bytes_a_vertex(tmp_path: Path) -> None:
    vertices, triangles = (
        np.random.default_rng(1).normal(size=(1000, 3)),
        np.arange(3000).reshape(-1, 3) % 1000,
    )
    with_chamber = model(3)
    n = with_chamber.phases
    surfaces = tuple(Mesh("mr", vertices + i, triangles) for i in range(n))
    bare = replace(with_chamber, chambers=())
    write_model(bare, tmp_path / "a.npz")
    write_model(replace(bare, chambers=(Chamber("lv_blood", surfaces),)), tmp_path / "b.npz")
    added = (tmp_path / "b.npz").stat().st_size - (tmp_path / "a.npz").stat().st_size
    assert n * 12_000 + 12_000 < added < n * 12_000 + 12_000 + 3000


def test_digest_depends_on_content() -> None:
    assert model_digest(model(1)) != model_digest(model(2))
    assert model_digest(model(1)) != model_digest(model(1, "patient-2"))
    empty = replace(model(1), chambers=())
    surfaces = tuple(Mesh("mr", mesh.vertices_mm + 1.0, mesh.triangles) for mesh in empty.reference)
    filled, renamed = (replace(empty, chambers=(Chamber(name, surfaces),)) for name in ("lv", "rv"))
    assert len({model_digest(m) for m in (empty, filled, renamed)}) == 3


def test_same_model_same_bytes(tmp_path: Path) -> None:
    write_model(model(1), tmp_path / "a.npz")
    write_model(model(1), tmp_path / "b.npz")
    assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()


def test_plain_numpy_reads_header_and_arrays(tmp_path: Path) -> None:
    write_model(model(3), tmp_path / "m.npz")
    with np.load(tmp_path / "m.npz", allow_pickle=False) as archive:
        header = json.loads(archive["header"].tobytes())
        np.testing.assert_array_equal(archive["coefficients"], model(3).coefficients)
    assert header["schema"] == "dvf_ig.model/1"
    assert header["units"]["length"] == "mm"
    assert header["patient_id"] == "patient-1"
    assert header["sha256"] == model_digest(model(3))


def test_another_patients_model(tmp_path: Path) -> None:
    write_model(model(), tmp_path / "m.npz")
    needed = "patient 'patient-1', needed patient 'patient-2'.*--patient 'patient-1'.*patient_id: 'patient-1'"
    with pytest.raises(InvalidInputError, match=needed):
        read_model(tmp_path / "m.npz", "patient-2")


def test_every_changed_byte_is_seen(tmp_path: Path) -> None:
    write_model(model(), tmp_path / "m.npz")
    data = bytearray((tmp_path / "m.npz").read_bytes())
    for at in (*range(0, len(data), 41), *range(len(data) - 90, len(data))):
        data[at] ^= 0x10
        (tmp_path / "x.npz").write_bytes(data)
        data[at] ^= 0x10
        with pytest.raises(UnreadableFileError, match=r"not an intact model|not a model"):
            read_model(tmp_path / "x.npz")


def test_content_that_is_not_what_its_header_was_made_for(tmp_path: Path) -> None:
    """The file is whole, but its header carries the digest of another model."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("dvf_ig.io.model.model_file._digest", lambda header, arrays: "0" * 64)
        write_model(model(), tmp_path / "m.npz")
    with pytest.raises(UnreadableFileError, match="changed"):
        read_model(tmp_path / "m.npz")


def test_bad_files(tmp_path: Path) -> None:
    path = tmp_path / "m.npz"
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_model(path)
    for data in (b"", b"garbage", b"PK garbage"):
        path.write_bytes(data)
        with pytest.raises(UnreadableFileError, match="model file"):
            read_model(path)
    buffer = io.BytesIO()
    np.savez(buffer, a=np.zeros(3))
    path.write_bytes(buffer.getvalue())
    with pytest.raises(UnreadableFileError, match="not written by dvf-ig"):
        read_model(path)
    write_model(model(), path)
    path.write_bytes(path.read_bytes()[:-1000])
    with pytest.raises(UnreadableFileError, match="truncated, changed"):
        read_model(path)


def test_a_large_damaged_file_is_refused_without_reading_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def unread(path: Path, what: str) -> bytes:
        raise AssertionError(f"{path} was read as {what}")

    monkeypatch.setattr("dvf_ig.io.model.model_file.read_bytes", unread)
    path = tmp_path / "m.npz"
    write_model(model(), path)
    whole = path.read_bytes()
    with path.open("r+b") as stream:
        stream.truncate(2 << 30)  # sparse: no byte of it is stored
    with pytest.raises(UnreadableFileError, match="not an intact model file \\(2147483648 bytes"):
        read_model(path)
    buffer = io.BytesIO()
    np.savez_compressed(buffer, a=np.zeros(1 << 20))
    path.write_bytes(buffer.getvalue()[:-2] + len(whole[-78:]).to_bytes(2, "little") + whole[-78:])
    with pytest.raises(UnreadableFileError, match="holds compressed arrays"):
        read_model(path)


def test_another_schema(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with monkeypatch.context() as patch:
        patch.setattr("dvf_ig.io.model.model_file.SCHEMA", "dvf_ig.model/3")
        write_model(model(), tmp_path / "m.npz")
    with pytest.raises(UnreadableFileError, match=r"schema 'dvf_ig\.model/3'; this version reads"):
        read_model(tmp_path / "m.npz")
