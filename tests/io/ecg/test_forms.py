"""One recording in every form in which a lab may bring it."""

import json
from collections.abc import Callable
from datetime import datetime, timedelta
from pathlib import Path

import edfio
import numpy as np
import pytest
from edf_files import write_ecg_edf
from typer.testing import CliRunner

from dvf_ig.cardiac import detect_r_peaks
from dvf_ig.cli.main import app
from dvf_ig.core import FloatArray, Signal, TrackedSequence, UnreadableFileError
from dvf_ig.io import add_ecg_field, read_ecg, write_ecg_csv, write_sequence

# ------------------------------------------------------------------ a real record


@pytest.fixture(scope="module")
def minute(data_dir: Path) -> Signal:
    """A minute of MIT-BIH 101, 360 Hz, digitised in steps of 0.005 mV."""
    return read_ecg(f"wfdb:{data_dir / 'mitdb-ds1' / '101'}").between(0.0, 60.0)


def beats_s(spec: object) -> list[float]:
    done = CliRunner().invoke(app, ["gate", str(spec), "--json"])
    assert done.exit_code == 0, done.output
    return [float(t_s) for t_s in json.loads(done.stdout)["beats_s"]]


@pytest.fixture(scope="module")
def minute_beats_s(minute: Signal, tmp_path_factory: pytest.TempPathFactory) -> list[float]:
    path = tmp_path_factory.mktemp("minute") / "101.csv"
    write_ecg_csv(minute, path)
    return beats_s(path)


def test_a_csv_shows_the_beats_of_the_record(
    minute: Signal, minute_beats_s: list[float], data_dir: Path
) -> None:
    longer = read_ecg(f"wfdb:{data_dir / 'mitdb-ds1' / '101'}").between(0.0, 90.0)
    found = [peak.t_s for peak in detect_r_peaks(longer)]
    assert len(minute_beats_s) == 71
    assert minute_beats_s == [t_s for t_s in found if t_s < minute_beats_s[-1] + 0.1]


def test_an_edf_shows_the_same_beats(minute: Signal, minute_beats_s: list[float], tmp_path: Path) -> None:
    """In the digitiser's own steps it holds the same numbers, in steps of 3 µV the same beats to a sample."""
    assert write_ecg_edf(minute, tmp_path / "a.edf") == 0.0
    np.testing.assert_array_equal(read_ecg(str(tmp_path / "a.edf")).samples, minute.samples)
    assert beats_s(tmp_path / "a.edf") == minute_beats_s
    leads = [
        edfio.EdfSignal(lead, 360, label=f"ECG {name}", physical_dimension="mV", physical_range=(-100, 100))
        for name, lead in zip(minute.leads, minute.samples.T, strict=True)
    ]
    edfio.Edf(leads).write(tmp_path / "b.edf")
    np.testing.assert_allclose(beats_s(tmp_path / "b.edf"), minute_beats_s, rtol=0, atol=1.001 / 360)


def test_a_field_of_a_sequence_shows_the_same_beats(
    minute: Signal, minute_beats_s: list[float], tmp_path: Path
) -> None:
    stamps = 0.05 + np.arange(0.0, 59.9, 0.05)
    write_sequence(TrackedSequence(stamps, None, np.zeros(len(stamps), bool), {}), tmp_path / "a.igs.mha")
    add_ecg_field(tmp_path / "a.igs.mha", minute, tmp_path / "b.igs.mha")
    assert beats_s(tmp_path / "b.igs.mha") == minute_beats_s
    told = json.loads(CliRunner().invoke(app, ["inspect", str(tmp_path / "b.igs.mha"), "--json"]).stdout)
    assert told["ecg"]["EcgData"]["rate_hz"] == 360
    assert told["ecg"]["EcgData"]["leads"] == ["MLII", "V1"]
    shown = CliRunner().invoke(app, ["inspect", str(tmp_path / "b.igs.mha")]).stdout
    assert "field EcgData: MLII, V1 in mV, 360 Hz for 60.00 s from 0.000 s" in shown


# ------------------------------------------------------------------ EDF


def edf_of(path: Path, samples: FloatArray, limits: tuple[float, float]) -> FloatArray:
    lead = edfio.EdfSignal(samples, 250, label="ECG", physical_dimension="mV", physical_range=limits)
    edfio.Edf([lead]).write(path)
    return read_ecg(f"edf:{path}").samples[:, 0]


@pytest.mark.parametrize("step", [0.0025, 0.005, 0.01, 1 / 1024])
def test_steps_of_a_digitiser_come_back_bit_for_bit(tmp_path: Path, step: float) -> None:
    samples = np.random.default_rng(1).integers(-2000, 2000, 500) * step
    samples = np.round(samples, 10)
    back = edf_of(tmp_path / "a.edf", samples, (round(-32768 * step, 5), round(32767 * step, 5)))
    if step == 1 / 1024:  # its range does not fit the header's eight characters
        np.testing.assert_allclose(back, samples, rtol=0, atol=5e-6)
    else:
        np.testing.assert_array_equal(back, samples)


def test_any_other_range_is_taken_as_the_header_says(tmp_path: Path) -> None:
    samples = np.random.default_rng(1).uniform(-1.3, 2.1, 500)
    back = edf_of(tmp_path / "a.edf", samples, (-1.37, 2.711))
    np.testing.assert_allclose(back, samples, rtol=0, atol=0.51 * 4.081 / 65535)
    lead = edfio.read_edf(tmp_path / "a.edf").signals[0]
    np.testing.assert_allclose(back, lead.data, rtol=0, atol=1e-12)


# ------------------------------------------------------------------ text tables

T_S = np.arange(2500) / 250.0
MV = np.round(np.sin(9.0 * T_S), 5)


def clock(t_s: float, form: str, *, hour: int = 13) -> str:
    return (datetime(2026, 3, 4, hour, 59, 55) + timedelta(microseconds=round(1e6 * t_s))).strftime(form)


TABLES: dict[str, tuple[str, Callable[[float, float], str], float]] = {
    "Timestamp, ECG": ("Timestamp,ECG", lambda t, v: f"{t:.3f},{v}", 0.0),
    "ms; decimal commas": ("Time (ms);ECG (mV)", lambda t, v: f"{1000 * t:.0f};{v}".replace(".", ","), 0.0),
    "time of day": ("Time,ECG", lambda t, v: f"{clock(t, '%H:%M:%S.%f')},{v}", 50395.0),
    "time of day; decimal commas": (
        "Uhrzeit;EKG",
        lambda t, v: f"{clock(t, '%H:%M:%S.%f')};{v}".replace(".", ","),
        50395.0,
    ),
    "past midnight": ("Time,ECG", lambda t, v: f"{clock(t, '%H:%M:%S.%f', hour=23)},{v}", 86395.0),
    "date and time": ("Timestamp,ECG", lambda t, v: f"{clock(t, '%Y-%m-%dT%H:%M:%S.%fZ')},{v}", 50395.0),
    "time of day without header": ("", lambda t, v: f"{clock(t, '%H:%M:%S.%f')},{v}", 50395.0),
    "rdsamp of PhysioNet": (
        "'Elapsed time','MLII'\n'hh:mm:ss.mmm','mV'",
        lambda t, v: f"'{int(t // 60)}:{t % 60:06.3f}',{v}",
        0.0,
    ),
    "a row of units": ("t,II\nms,mV", lambda t, v: f"{1000 * t:.0f},{v}", 0.0),
    "blanks": ("", lambda t, v: f"{t:.3f}  {v}", 0.0),
    "a comma at the end": ("t,II,", lambda t, v: f"{t:.3f},{v},", 0.0),
    "ECG first": ("ECG,Timestamp", lambda t, v: f"{v},{t:.3f}", 0.0),
    "Unix time in ns": ("time_ns,ecg", lambda t, v: f"{17 * 10**17 + round(1e9 * t)},{v}", 1.7e9),
}


@pytest.mark.parametrize("kind", TABLES)
def test_tables_that_labs_bring(tmp_path: Path, kind: str) -> None:
    header, row, start_s = TABLES[kind]
    rows = [row(t, v) for t, v in zip(T_S.tolist(), MV.tolist(), strict=True)]
    (tmp_path / "ecg.csv").write_text("\n".join([header, *rows] if header else rows) + "\n")
    signal = read_ecg(str(tmp_path / "ecg.csv"))
    np.testing.assert_array_equal(signal.samples, MV[:, None])
    assert signal.rate_hz == pytest.approx(250, rel=1e-6)
    assert signal.start_s == pytest.approx(start_s, abs=1e-6)
    assert signal.unit == "mV"


def test_units_in_a_second_row_count(tmp_path: Path) -> None:
    (tmp_path / "e.csv").write_text("t,II\ns,uV\n" + "".join(f"{t:.3f},1.5\n" for t in T_S))
    assert read_ecg(str(tmp_path / "e.csv")).unit == "uV"


@pytest.mark.parametrize(
    ("header", "row", "message"),
    [
        ("t_s,II", "{ms:.0f},{v}", r"step by 4 s \(column 't_s'\); no ECG is sampled at 0.25 Hz"),
        ("t_ms,II", "{t:.3f},{v}", r"step by 0.004 ms \(column 't_ms'\); no ECG is sampled at 2.5e\+05 Hz"),
        ("Time,II", "{t:.0f},{v}", "written too coarsely, leave their column out and give"),
        ("II", "{v}", "^[^:]*ecg.csv has no column of times"),
        ("Time,II", "about {t:.3f},{v}", "needed numbers only"),
    ],
)
def test_misreadings_are_refused(tmp_path: Path, header: str, row: str, message: str) -> None:
    rows = [row.format(t=t, ms=1000 * t, v=v) for t, v in zip(T_S.tolist(), MV.tolist(), strict=True)]
    (tmp_path / "ecg.csv").write_text("\n".join([header, *rows]) + "\n")
    with pytest.raises(UnreadableFileError, match=message):
        read_ecg(str(tmp_path / "ecg.csv"))


def test_a_rate_other_than_the_files_is_refused_naming_both(tmp_path: Path) -> None:
    edf_of(tmp_path / "a.edf", MV[:2500], (-2.0, 2.0))
    assert read_ecg(f"edf:{tmp_path / 'a.edf'}", 250.0).rate_hz == 250.0
    with pytest.raises(UnreadableFileError, match="sampled at 250 Hz, but --rate is 500 Hz"):
        read_ecg(f"edf:{tmp_path / 'a.edf'}", 500.0)
