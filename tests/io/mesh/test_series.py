"""A surface through the cycle: folders, archives, timing, correspondence."""

import tarfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from dvf_ig.core import CycleTiming, Mesh, SurfaceSeries, UnreadableFileError
from dvf_ig.io import read_mesh, read_surface_series, surface_names, write_mesh, write_surface_series

CORNERS = np.array([[0.1, 0, 0], [10, 0.2, 0], [0, 10, 0.3], [0.4, 0, 10]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])


def test_real_archive_of_surfaces(data_dir: Path) -> None:
    folder = data_dir / "bivme-cine"
    before = sorted(p.name for p in folder.iterdir())
    assert surface_names(folder) == ["EPICARDIAL", "LV_ENDOCARDIAL", "RV_ENDOCARDIAL"]
    series = read_surface_series(folder)
    assert series.patient_id == "patient1"
    assert series.vertices_mm.shape == (25, 2502, 3)
    assert series.triangles.shape == (4864, 3)
    assert series.timing.rr_s == pytest.approx(0.82883, abs=1e-5)
    assert not series.timing.rr_assumed
    assert series.vertices_mm[0, 0].tolist() == [26.2490, 28.9452, -85.2875]
    with pytest.raises(UnreadableFileError, match="no surface 'AORTA'; it has EPICARDIAL, LV_ENDO"):
        read_surface_series(folder, "AORTA")
    with pytest.raises(UnreadableFileError, match="patient1_LV_ENDOCARDIAL, patient1_RV_ENDOCARDIAL"):
        read_surface_series(folder, "ENDOCARDIAL")
    assert sorted(p.name for p in folder.iterdir()) == before


def series(phases: int = 3) -> SurfaceSeries:
    vertices = np.stack([CORNERS + i / 3 for i in range(phases)])
    timing = CycleTiming(np.linspace(0, 0.7, phases), 0.91)
    caps = np.array([False, True, False, False])
    return SurfaceSeries("EPICARDIAL", "mr", vertices, FACES, timing, "unknown", caps)


def test_series_round_trip(tmp_path: Path) -> None:
    write_surface_series(series(), tmp_path / "new")
    back = read_surface_series(tmp_path / "new")
    np.testing.assert_array_equal(back.vertices_mm, series().vertices_mm)
    np.testing.assert_array_equal(back.caps, series().caps)
    assert back.timing.fractions.tolist() == series().timing.fractions.tolist()
    assert back.timing.rr_s == 0.91
    assert back.patient_id == "unknown"
    (tmp_path / "new" / "timing.json").unlink()
    assumed = read_surface_series(tmp_path / "new")
    assert assumed.timing.rr_assumed
    assert assumed.timing.rr_s == 1.0


def test_ten_phases_are_in_order_of_their_number(tmp_path: Path) -> None:
    for i in range(11):
        write_mesh(Mesh("mr", CORNERS + i, FACES), tmp_path / f"p9_EPI_{i}.stl")
    back = read_surface_series(tmp_path, "EPI")
    np.testing.assert_allclose(back.vertices_mm[:, 0, 0], CORNERS[0, 0] + np.arange(11), atol=1e-5)
    assert back.patient_id == "p9"


def test_bad_series(tmp_path: Path) -> None:
    write_surface_series(series(4), tmp_path / "s")
    (tmp_path / "s" / "EPICARDIAL_002.vtp").rename(tmp_path / "kept.vtp")
    with pytest.raises(UnreadableFileError, match=r"consecutive .see number 2"):
        read_surface_series(tmp_path / "s")
    write_mesh(Mesh("mr", CORNERS, FACES[:3]), tmp_path / "s" / "EPICARDIAL_002.vtp")
    with pytest.raises(UnreadableFileError, match="same vertices in every phase"):
        read_surface_series(tmp_path / "s")
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_surface_series(tmp_path / "none")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UnreadableFileError, match="it has none"):
        read_surface_series(tmp_path / "empty")
    (tmp_path / "empty" / "broken.tar.gz").write_bytes(b"garbage")
    with pytest.raises(UnreadableFileError, match=r"broken\.tar\.gz is not a readable archive"):
        read_surface_series(tmp_path / "empty")


@pytest.mark.parametrize(
    ("factor", "unit"), [(0.001, r"in m \(then 10\.1 mm\)"), (0.1, "in cm"), (1e3, "in um")]
)
def test_surfaces_in_another_unit_are_refused(tmp_path: Path, factor: float, unit: str) -> None:
    small = series()
    write_surface_series(replace(small, vertices_mm=1.01 * factor * small.vertices_mm), tmp_path)
    with pytest.raises(UnreadableFileError, match=rf"EPICARDIAL_000\.vtp: the surface is .* {unit}"):
        read_surface_series(tmp_path)


def test_attributes_of_macos_are_no_surface(tmp_path: Path) -> None:
    write_surface_series(series(), tmp_path)
    alone = tmp_path / "._EPICARDIAL_000.vtp"
    alone.write_bytes(b"\x00\x05\x16\x07\x00\x02\x00\x00Mac OS X")
    assert len(read_surface_series(tmp_path).timing) == 3
    with pytest.raises(UnreadableFileError, match=r"attributes that macOS keeps.*give EPICARDIAL_000\.vtp"):
        read_mesh(alone)


def test_timing_of_another_number_of_phases(tmp_path: Path) -> None:
    write_surface_series(series(3), tmp_path)
    (tmp_path / "timing.json").write_text('{"fractions": [0, 0.5], "rr_s": 0.8}')
    with pytest.raises(UnreadableFileError, match="times 2 phases, the data have 3"):
        read_surface_series(tmp_path)
    for text, message in [("[]", "not a timing file"), ('{"fractions": ["a"], "rr_s": 1}', "not numbers")]:
        (tmp_path / "timing.json").write_text(text)
        with pytest.raises(UnreadableFileError, match=message):
            read_surface_series(tmp_path)


def test_archive_members_are_never_extracted(tmp_path: Path) -> None:
    write_surface_series(series(3), tmp_path / "s")
    (tmp_path / "a").mkdir()
    with tarfile.open(tmp_path / "a" / "x.tar", "w") as tar:
        for path in sorted((tmp_path / "s").glob("*.vtp")):
            tar.add(path, f"../../escaped/{path.name}")
    assert read_surface_series(tmp_path / "a").vertices_mm.shape == (3, 4, 3)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a", "s"]
