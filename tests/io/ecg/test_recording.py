"""ECG files: a real MIT-BIH record, CSV round trips, uneven sampling, EDF, and missing packages."""

import sys
from pathlib import Path

import edfio
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import InvalidInputError, MissingDependencyError, Signal, UnreadableFileError
from dvf_ig.io import read_annotations, read_ecg, write_ecg_csv


def test_record_101(data_dir: Path) -> None:
    signal = read_ecg(f"wfdb:{data_dir / 'mitdb-ds1' / '101'}")
    assert signal.samples.shape == (650_000, 2)
    assert (signal.rate_hz, signal.leads, signal.unit) == (360.0, ("MLII", "V1"), "mV")
    # The header states first raw values 955 and 992, baseline 1024, gain 200 / mV.
    np.testing.assert_allclose(signal.samples[0], [(955 - 1024) / 200, (992 - 1024) / 200])
    assert read_ecg(f"wfdb:{data_dir / 'mitdb-ds1' / '101.hea'}").rate_hz == 360.0


def test_annotations_of_record_101(data_dir: Path) -> None:
    beats = read_annotations(f"wfdb:{data_dir / 'mitdb-ds1' / '101'}").t_s
    assert len(beats) == 1865  # 1860 normal, 3 atrial premature, 2 unclassifiable (PhysioNet's table)
    assert (np.diff(beats) > 0).all()
    assert beats[-1] < 650_000 / 360


def test_csv_of_a_real_record_is_exact(data_dir: Path, tmp_path: Path) -> None:
    part = read_ecg(f"wfdb:{data_dir / 'mitdb-ds1' / '101'}").between(10.0, 20.0)
    write_ecg_csv(part, tmp_path / "e.csv")
    back = read_ecg(f"csv:{tmp_path / 'e.csv'}")
    np.testing.assert_array_equal(back.samples, part.samples)
    assert (back.rate_hz, back.start_s, back.leads) == (part.rate_hz, part.start_s, part.leads)


@given(
    rate=st.sampled_from([100.0, 128.0, 250.0, 257.0, 360.0, 500.0, 1000.0, 2000.0, 4096.0, 333.25]),
    start=st.floats(-1e5, 1e5),
    n=st.integers(2, 400),
)
def test_csv_keeps_rate_and_start(
    tmp_path_factory: pytest.TempPathFactory, rate: float, start: float, n: int
) -> None:
    signal = Signal(np.linspace(-1, 1, n)[:, None], rate, start, ("II",))
    path = tmp_path_factory.mktemp("case") / "e.csv"
    write_ecg_csv(signal, path)
    back = read_ecg(f"csv:{path}")
    np.testing.assert_array_equal(back.t_s, signal.t_s)
    assert back.rate_hz == pytest.approx(rate, rel=1e-6)
    assert back.start_s == start


def test_csv_header_is_what_a_spreadsheet_expects(tmp_path: Path) -> None:
    write_ecg_csv(Signal(np.array([[0.5, -1], [0.25, np.nan]]), 250.0, 2.0, ("II", "V1")), tmp_path / "e.csv")
    assert (tmp_path / "e.csv").read_text() == "t_s,II,V1\n2.0,0.5,-1.0\n2.004,0.25,nan\n"
    write_ecg_csv(Signal(np.zeros((2, 1)), 250.0, 0.0, ("II",), "uV"), tmp_path / "u.csv")
    assert (tmp_path / "u.csv").read_text().startswith("t_s,II [uV]\n")
    assert read_ecg(f"csv:{tmp_path / 'u.csv'}").unit == "uV"


def test_csv_with_rounded_times_and_missing_samples(tmp_path: Path) -> None:
    rows = [f"{round(i / 360, 4)},{'' if i == 7 else i},{i}" for i in range(720)]
    (tmp_path / "e.csv").write_text("t_s,II,V1\r\n" + "\r\n".join(rows) + "\r\n")
    signal = read_ecg(f"csv:{tmp_path / 'e.csv'}")
    assert signal.rate_hz == pytest.approx(360, rel=1e-3)
    assert np.flatnonzero(np.isnan(signal.samples[:, 0])).tolist() == [7]


UNEVEN = [
    [0, 1, 2, 4, 5, 6],
    [0, 1, 1, 2, 3, 4],
    [0, 1, 2, float("nan"), 4, 5],
    [5, 4, 3, 2, 1, 0],
    [*range(100), *(99 + 1.4 * i for i in range(1, 100))],
]


@pytest.mark.parametrize("steps", UNEVEN, ids=["gap", "repeat", "nan", "backwards", "rate change"])
def test_uneven_sampling_is_refused(tmp_path: Path, steps: list[float]) -> None:
    text = "t_s,II\n" + "".join(f"{step / 250},0\n" for step in steps)
    (tmp_path / "e.csv").write_text(text)
    with pytest.raises(UnreadableFileError, match="not evenly spaced"):
        read_ecg(f"csv:{tmp_path / 'e.csv'}")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "has no rows"),
        ("time,II\n0,1\n", "has 1 rows"),
        ("t_s,II\n", "has no rows"),
        ("t_s,II\n0,1\n", "has 1 rows"),
        ("t_s,II\n0,one\n0.1,2\n", "needed numbers only"),
        ("t_s,II\n0,1,2\n0.1,2,3\n", "3 cells under 2 names"),
        ("t_s,II [uV],V1\n0,1,2\n0.1,2,3\n", "different units"),
    ],
)
def test_bad_csv(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "e.csv").write_text(text)
    with pytest.raises(UnreadableFileError, match=message):
        read_ecg(f"csv:{tmp_path / 'e.csv'}")


def test_edf(tmp_path: Path) -> None:
    wave = np.sin(np.arange(1000) / 40) * 800
    ecg = edfio.EdfSignal(wave, 250, label="ECG II", physical_dimension="uV", physical_range=(-1000, 1000))
    pleth = edfio.EdfSignal(np.zeros(400), 100, label="Pleth", physical_range=(-1, 1))
    edfio.Edf([ecg, pleth]).write(tmp_path / "e.edf")
    signal = read_ecg(f"edf:{tmp_path / 'e.edf'}")
    assert (signal.leads, signal.rate_hz, signal.unit) == (("ECG II",), 250.0, "mV")
    np.testing.assert_allclose(signal.samples[:, 0], wave / 1000, atol=2 * 2.0 / 65535)


@pytest.mark.parametrize("spec", ["101", "mat:101", "csv:", ""])
def test_unknown_spec(spec: str) -> None:
    with pytest.raises(InvalidInputError, match="names no ECG"):
        read_ecg(spec)


def test_absent_and_garbage(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_ecg(f"csv:{tmp_path / 'none.csv'}")
    with pytest.raises(UnreadableFileError, match=r"none\.hea does not exist"):
        read_ecg(f"wfdb:{tmp_path / 'none'}")
    with pytest.raises(UnreadableFileError, match="does not exist"):
        read_ecg(f"edf:{tmp_path / 'none.edf'}")
    for name, spec in (("g.hea", "wfdb:g"), ("g.edf", "edf:g.edf")):
        (tmp_path / name).write_text("garbage garbage\n")
        kind, _, path = spec.partition(":")
        with pytest.raises(UnreadableFileError, match="not a readable"):
            read_ecg(f"{kind}:{tmp_path / path}")
    with pytest.raises(UnreadableFileError, match=r"g\.atr does not exist"):
        read_annotations(f"wfdb:{tmp_path / 'g'}")


def test_truncated_wfdb(tmp_path: Path, data_dir: Path) -> None:
    for ending in ("hea", "dat"):
        data = (data_dir / "mitdb-ds1" / f"101.{ending}").read_bytes()
        (tmp_path / f"101.{ending}").write_bytes(data if ending == "hea" else data[:3000])
    with pytest.raises(UnreadableFileError, match="101: not a readable WFDB record"):
        read_ecg(f"wfdb:{tmp_path / '101'}")


@pytest.mark.parametrize(("spec", "package"), [("wfdb:x", "wfdb")])
def test_missing_package(monkeypatch: pytest.MonkeyPatch, spec: str, package: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(MissingDependencyError, match=rf"needs the package {package}; .*\.\[ecg\]"):
        read_ecg(spec)
