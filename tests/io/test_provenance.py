"""Inputs of a result: each file that a reader opens, named as the user did, with its digest and size."""

import hashlib
import json
import shutil
import tarfile
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import SimpleITK

from dvf_ig.core import Preop, Rigid, Signal, UnreadableFileError
from dvf_ig.intake import cached_model
from dvf_ig.io import (
    provenance_fields,
    read_annotations,
    read_ecg,
    read_poses,
    read_sequence,
    read_surface_series,
    read_transform,
    read_volume,
    write_ecg_csv,
    write_surface_series,
    write_transforms,
)
from dvf_ig.io.ecg.wfdb_header import read_record_header
from dvf_ig.io.provenance import not_recorded, recorded_inputs, versions
from dvf_ig.io.reading import read_text, reading


def inputs_of(read: Callable[[], Any]) -> dict[str, tuple[str, int]]:
    """Digest and size by name, of what `read` opens."""
    with recorded_inputs():
        read()
        listed = provenance_fields()["inputs"]
    return {one["file"]: (one["sha256"], one["bytes"]) for one in listed}


def digests(folder: Path, *names: str) -> dict[str, tuple[str, int]]:
    contents = {name: (folder / name).read_bytes() for name in names}
    return {name: (hashlib.sha256(data).hexdigest(), len(data)) for name, data in contents.items()}


def image(path: Path) -> Path:
    values = np.arange(4 * 5 * 6, dtype=np.int16).reshape(6, 5, 4)
    SimpleITK.WriteImage(SimpleITK.GetImageFromArray(values), str(path))
    return path


@pytest.mark.parametrize(
    ("header", "voxels"), [("a.mha", []), ("a.nrrd", []), ("a.mhd", ["a.raw"]), ("a.nhdr", ["a.raw"])]
)
def test_an_image_counts_with_its_detached_voxels(tmp_path: Path, header: str, voxels: list[str]) -> None:
    path = image(tmp_path / header)
    assert inputs_of(lambda: read_volume(path)) == digests(tmp_path, header, *voxels)


@pytest.mark.parametrize(
    "listed", ["s%02d.raw 1 6 1", "LIST\n" + "\n".join(f"s{n:02d}.raw" for n in range(1, 7))]
)
def test_voxels_in_several_files_all_count(tmp_path: Path, listed: str) -> None:
    image(tmp_path / "a.mhd")
    data = (tmp_path / "a.raw").read_bytes()
    for n in range(6):
        (tmp_path / f"s{n + 1:02d}.raw").write_bytes(data[40 * n : 40 * n + 40])
    header = (tmp_path / "a.mhd").read_text().replace("a.raw", listed)
    (tmp_path / "b.mhd").write_text(header)
    volume = inputs_of(lambda: read_volume(tmp_path / "b.mhd"))
    assert volume == digests(tmp_path, "b.mhd", *(f"s{n:02d}.raw" for n in range(1, 7)))


def test_a_sequence_counts_with_its_pixels(tmp_path: Path, data_dir: Path) -> None:
    header = "ObjectType = Image\nNDims = 3\nDimSize = 2 2 3\nElementType = MET_UCHAR\nElementDataFile = "
    (tmp_path / "us.igs.mhd").write_text(header + "us.raw\n")
    (tmp_path / "us.raw").write_bytes(bytes(12))
    found = inputs_of(lambda: read_sequence(tmp_path / "us.igs.mhd"))
    assert found == digests(tmp_path, "us.igs.mhd", "us.raw")


def test_a_wfdb_record_counts_with_header_signals_and_notes(tmp_path: Path, data_dir: Path) -> None:
    for ending in ("hea", "dat", "atr"):
        shutil.copy(data_dir / "mitdb-ds1" / f"101.{ending}", tmp_path)
    assert inputs_of(lambda: read_ecg(f"wfdb:{tmp_path / '101'}")) == digests(tmp_path, "101.hea", "101.dat")
    found = inputs_of(lambda: read_annotations(f"wfdb:{tmp_path / '101.dat'}"))
    assert found == digests(tmp_path, "101.atr", "101.hea")


def test_edf_and_csv_count(tmp_path: Path) -> None:
    edfio = pytest.importorskip("edfio")
    samples = np.sin(np.arange(500) / 20.0)
    edfio.Edf([edfio.EdfSignal(samples, 250, label="ECG", physical_dimension="mV")]).write(tmp_path / "a.edf")
    write_ecg_csv(Signal(samples[:, None], 250.0, 0.0, ("II",)), tmp_path / "a.csv")
    for name in ("a.edf", "a.csv"):
        assert inputs_of(partial(read_ecg, str(tmp_path / name))) == digests(tmp_path, name)


def test_the_members_of_a_folder_count_by_their_place_in_it(tmp_path: Path, beating_sphere) -> None:
    write_surface_series(beating_sphere, tmp_path / "s")
    shutil.copy(tmp_path / "s" / "EPICARDIAL_000.vtp", tmp_path / "s" / "OTHER_000.vtp")
    names = [*(f"EPICARDIAL_{i:03d}.vtp" for i in range(3)), "timing.json"]
    assert inputs_of(lambda: read_surface_series(tmp_path / "s")) == digests(tmp_path / "s", *names)
    with tarfile.open(tmp_path / "all.tar", "w") as archive:
        archive.add(tmp_path / "s", arcname="s")
    shutil.rmtree(tmp_path / "s")
    (tmp_path / "s").mkdir()
    (tmp_path / "all.tar").rename(tmp_path / "s" / "all.tar")
    assert inputs_of(lambda: read_surface_series(tmp_path / "s")) == digests(tmp_path / "s", "all.tar")


def test_a_folder_of_poses_and_a_transform_with_its_sidecar(tmp_path: Path) -> None:
    (tmp_path / "poses").mkdir()
    for n in range(3):
        np.savetxt(tmp_path / "poses" / f"{n}.txt", np.eye(4))
    found = inputs_of(lambda: read_poses(tmp_path / "poses", "tracker", "tool"))
    assert found == digests(tmp_path / "poses", "0.txt", "1.txt", "2.txt")
    write_transforms(Rigid.identity("mr", "tracker"), tmp_path / "t.tfm")
    for name in ("t.tfm", "t.h5"):
        assert inputs_of(partial(read_transform, tmp_path / name)) == digests(tmp_path, "t.json", name)


def test_names_are_the_users_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "a.txt").write_text("a")
    monkeypatch.chdir(tmp_path)
    assert list(inputs_of(lambda: read_text(Path("in/a.txt"), "text"))) == ["in/a.txt"]
    assert list(inputs_of(lambda: read_text(Path("../") / tmp_path.name / "in/a.txt", "text"))) == [
        f"../{tmp_path.name}/in/a.txt"
    ]
    assert list(inputs_of(lambda: read_text(tmp_path / "in" / "a.txt", "text"))) == ["a.txt"]


def test_a_file_counts_once_and_again_when_it_changes(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    with recorded_inputs():
        for content in ("one", "one", "three"):
            if not path.exists() or path.read_text() != content:
                path.write_text(content)
            read_text(path, "text")
        listed = provenance_fields()["inputs"]
    assert [one["bytes"] for one in listed] == [3, 5]
    assert [one["sha256"] for one in listed] == [hashlib.sha256(c).hexdigest() for c in (b"one", b"three")]


def test_what_was_not_read_or_not_understood_does_not_count(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("not a table")

    def fails() -> None:
        with pytest.raises(UnreadableFileError):
            read_volume(tmp_path / "none.mha")
        with not_recorded():
            read_text(tmp_path / "a.csv", "text")

    assert inputs_of(fails) == {}
    read_text(tmp_path / "a.csv", "text")
    assert provenance_fields() == {}


def test_a_cached_model_counts_by_what_it_was_built_from(
    tmp_path: Path, beating_sphere, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DVF_IG_CACHE", str(tmp_path / "cache"))
    write_surface_series(beating_sphere, tmp_path / "s")

    def build() -> bool:
        series = read_surface_series(tmp_path / "s")
        return cached_model(Preop(patient_id="unknown", surfaces=(series,), surface="EPICARDIAL")).was_cached

    first = inputs_of(build)
    assert build()
    assert inputs_of(build) == first
    assert len(first) == 4


def test_versions_name_what_computes() -> None:
    found = versions()
    assert {"dvf_ig", "python", "numpy", "scipy", "numba", "SimpleITK"} <= found.keys()
    assert found["numpy"] == np.__version__
    assert None not in found.values()


def test_every_segment_of_a_wfdb_record_counts(tmp_path: Path) -> None:
    (tmp_path / "all.hea").write_text("all/2 1 250 900\none 400\ntwo 500\n")
    for name, length, signals in (("one", 400, ["a.dat", "a.dat"]), ("two", 500, ["b.dat"])):
        lines = [
            f"{name} {len(signals)} 250 {length}",
            *(f"{signal} 16 200" for signal in signals),
            "# a remark",
        ]
        (tmp_path / f"{name}.hea").write_text("\n".join(lines))
        for signal in signals:
            (tmp_path / signal).write_bytes(bytes(1600))
    found = [path.name for path in read_record_header(tmp_path / "all").files]
    assert found == ["all.hea", "one.hea", "a.dat", "two.hea", "b.dat"]


def test_a_file_that_changes_while_it_is_read_is_refused(tmp_path: Path) -> None:
    path = image(tmp_path / "a.mha")

    def changed() -> None:
        with reading(path, "an image"):
            path.write_bytes(b"more" + path.read_bytes())

    with pytest.raises(UnreadableFileError, match=r"a\.mha changed while it was read"):
        inputs_of(changed)
    changed()


def test_the_sidecar_of_a_transform_says_what_it_was_made_from(tmp_path: Path) -> None:
    (tmp_path / "a.txt").write_text("a")
    with recorded_inputs():
        read_text(tmp_path / "a.txt", "text")
        write_transforms(Rigid.identity("mr", "tracker"), tmp_path / "t.tfm")
    written = json.loads((tmp_path / "t.json").read_text())
    assert [one["file"] for one in written["inputs"]] == ["a.txt"]
    assert written["versions"] == versions()
    assert (written["kind"], written["to"]) == ("transform", "mr")


def test_the_pair_of_an_analyze_image_counts(tmp_path: Path) -> None:
    image(tmp_path / "a.img")
    assert inputs_of(lambda: read_volume(tmp_path / "a.hdr")) == digests(tmp_path, "a.hdr", "a.img")
