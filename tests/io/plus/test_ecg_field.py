"""An ECG inside a PLUS sequence: what is written comes back; what PLUS itself records is put in its place."""

import logging
import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from dvf_ig.core import FloatArray, InvalidInputError, Signal, TrackedSequence, UnreadableFileError
from dvf_ig.intake import describe
from dvf_ig.io import add_ecg_field, read_ecg, read_ecg_field, read_sequence, write_sequence

RATE_HZ = 500.0


def wave(t_s: FloatArray) -> FloatArray:
    """(n,) a smooth trace that never repeats, so that a sample's value tells its time."""
    return np.asarray(np.sin(7.0 * t_s) + 0.5 * np.sin(23.0 * t_s + t_s**2))


def recorded(
    path: Path, stamps_s: FloatArray, lines: list[str | None], *, name: str = "EcgData", extra: str = ""
) -> Path:
    """A sequence without images whose frame i carries line i; `extra` goes into its header."""
    text = f"ObjectType = Image\nNDims = 3\nDimSize = 0 0 {len(lines)}\nElementType = MET_UCHAR\n{extra}"
    for i, (stamp_s, line) in enumerate(zip(stamps_s.tolist(), lines, strict=True)):
        text += f"Seq_Frame{i:04d}_Timestamp = {stamp_s!r}\n"
        text += "" if line is None else f"Seq_Frame{i:04d}_{name} = {line}\n"
    path.write_text(text + "ElementDataFile = LOCAL\n")
    return path


def batched(t_s: FloatArray, stamps_s: FloatArray) -> list[list[int]]:
    """Indices of the samples that came since the last frame, for each frame."""
    bounds = np.searchsorted(t_s, stamps_s, side="right")
    return [list(range(a, b)) for a, b in zip([0, *bounds[:-1].tolist()], bounds.tolist(), strict=True)]


def lines_of(batches: list[list[int]], values: FloatArray, between: str = " ") -> list[str | None]:
    return [between.join(f"{values[k]:.6f}" for k in batch) for batch in batches]


def time_error_s(signal: Signal, *, clear_of_s: float = 0.0) -> float:
    """Largest error of the samples' times, by the trace's own slope, where it is steep."""
    t_s = signal.t_s[np.isfinite(signal.samples[:, 0])]
    values = signal.samples[np.isfinite(signal.samples[:, 0]), 0]
    slope = np.gradient(wave(t_s), t_s)
    steep = np.abs(slope) > 8.0
    return float(np.abs((values - wave(t_s)) / slope)[steep].max())


# ------------------------------------------------------------------ written and read back


@given(
    rate_hz=st.sampled_from([200.0, 333.25, 500.0, 1000.0, 499.9871]),
    start_s=st.floats(-1e5, 1e5),
    frame_hz=st.floats(5.0, 60.0),
    leads=st.integers(1, 3),
    first_frame_s=st.floats(-0.5, 0.7),
)
def test_what_is_written_comes_back_digit_for_digit(
    tmp_path_factory: pytest.TempPathFactory,
    rate_hz: float,
    start_s: float,
    frame_hz: float,
    leads: int,
    first_frame_s: float,
) -> None:
    folder = tmp_path_factory.mktemp("case")
    samples = np.random.default_rng(3).standard_normal((700, leads))
    signal = Signal(samples, rate_hz, start_s, ("II", "V1", "aVF")[:leads], "mV")
    stamps = start_s + first_frame_s + np.arange(12) / frame_hz
    write_sequence(TrackedSequence(stamps, None, np.zeros(12, bool), {}), folder / "a.igs.mha")
    add_ecg_field(folder / "a.igs.mha", signal, folder / "b.igs.mha")
    back = read_ecg(str(folder / "b.igs.mha"))
    np.testing.assert_array_equal(back.samples, samples)
    assert (back.rate_hz, back.start_s, back.leads, back.unit) == (rate_hz, start_s, signal.leads, "mV")


def test_images_and_poses_stay_as_they_are(tmp_path: Path) -> None:
    images = np.arange(2 * 3 * 4, dtype=np.uint8).reshape(2, 3, 4)
    write_sequence(
        TrackedSequence(np.array([1.0, 2.0]), images, np.ones(2, bool), {}), tmp_path / "a.igs.mha"
    )
    add_ecg_field(
        tmp_path / "a.igs.mha", Signal(np.ones((900, 1)), 500.0, 0.5, ("II",)), tmp_path / "a.igs.mha"
    )
    np.testing.assert_array_equal(read_sequence(tmp_path / "a.igs.mha").images, images)
    with pytest.raises(InvalidInputError, match="cannot be added"):
        add_ecg_field(
            tmp_path / "a.igs.mha", Signal(np.ones((9, 1)), 500.0, 0.5, ("II",)), tmp_path / "b.igs.mha"
        )


def test_a_lost_frame_leaves_a_gap(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    t = np.arange(2000) / RATE_HZ
    write_sequence(
        TrackedSequence(np.arange(1, 41) / 10.0, None, np.zeros(40, bool), {}), tmp_path / "a.igs.mha"
    )
    add_ecg_field(
        tmp_path / "a.igs.mha", Signal(wave(t)[:, None], RATE_HZ, 0.0, ("II",)), tmp_path / "b.igs.mha"
    )
    text = (tmp_path / "b.igs.mha").read_text()
    (tmp_path / "c.igs.mha").write_text(re.sub(r"Seq_Frame0007_EcgData.*\n", "", text))
    signal = read_ecg_field(tmp_path / "c.igs.mha")
    missing = np.isnan(signal.samples[:, 0])
    assert np.flatnonzero(missing)[[0, -1]].tolist() == [351, 400]
    np.testing.assert_array_equal(signal.samples[~missing, 0], wave(t)[~missing])
    assert "lacks 50 samples at 1 places" in caplog.text
    (tmp_path / "d.igs.mha").write_text(
        text.replace(
            "Seq_Frame0003_EcgDataT", "Seq_Frame0003_EcgDataStatus = INVALID\nSeq_Frame0003_EcgDataT"
        )
    )
    assert np.flatnonzero(np.isnan(read_ecg_field(tmp_path / "d.igs.mha").samples[:, 0])).size == 50


# ------------------------------------------------------------------ times from the frames' stamps


@pytest.mark.parametrize("jitter_s", [0.0, 0.002])
@pytest.mark.parametrize("between", [" ", ",", "; "])
def test_times_follow_from_counts_and_stamps(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, between: str, jitter_s: float
) -> None:
    true_hz = 499.87  # the device's own clock
    rng = np.random.default_rng(5)
    t = 10.0 + np.arange(5000) / true_hz
    stamps = np.arange(10.05, 19.9, 0.04) + rng.uniform(-0.01, 0.01, 247)[: len(np.arange(10.05, 19.9, 0.04))]
    lines = lines_of(batched(t, stamps), wave(t), between)
    path = recorded(tmp_path / "a.igs.mha", stamps + rng.uniform(0, jitter_s, len(stamps)), lines)
    with caplog.at_level(logging.WARNING):
        signal = read_ecg_field(path)
    assert signal.rate_hz == pytest.approx(true_hz, rel=2e-4)
    assert time_error_s(signal) < 0.0015 + jitter_s
    assert signal.unit == "unknown"
    assert "are estimated from the time stamps" in caplog.text


@pytest.mark.parametrize("lost", [[60], [60, 61, 62], [20, 60, 63, 170]])
def test_lost_lines_are_not_closed_up(tmp_path: Path, lost: list[int]) -> None:
    t = np.arange(5000) / RATE_HZ
    stamps = np.arange(0.05, 9.9, 0.04)
    lines = lines_of(batched(t, stamps), wave(t))
    for i in lost:
        lines[i] = None
    signal = read_ecg_field(recorded(tmp_path / "a.igs.mha", stamps, lines))
    assert np.isnan(signal.samples).sum() == pytest.approx(20 * len(lost), abs=len(lost))
    assert time_error_s(signal) < 0.004


def test_a_stall_that_is_caught_up_loses_nothing(tmp_path: Path) -> None:
    t = np.arange(5000) / RATE_HZ
    stamps = np.arange(0.05, 9.9, 0.04)
    lines = lines_of(batched(t, stamps), wave(t))
    stamps[100:103] += [0.09, 0.06, 0.03]
    signal = read_ecg_field(recorded(tmp_path / "a.igs.mha", stamps, lines))
    assert not np.isnan(signal.samples).any()
    assert time_error_s(signal) < 0.003


def test_one_number_a_frame(tmp_path: Path) -> None:
    t = 3.0 + np.arange(3000) / 250.0
    path = recorded(tmp_path / "a.igs.mha", t + 0.001, [f"{v:.4f}" for v in wave(t)])
    signal = read_ecg_field(path)
    assert signal.rate_hz == pytest.approx(250.0, rel=1e-6)
    assert time_error_s(signal) < 0.0015


def plus_recording(path: Path, *, line_samples: int, frame_hz: float, line_delay_s: float = 0.004) -> Path:
    """As PLUS records: each frame gets the line nearest in time, and is stamped with that line's arrival.

    Frames whose stamp is not new are left out (vtkIGSIOTrackedFrameList::ValidateTimestamp).
    """
    t = np.arange(6000) / RATE_HZ
    arrival = t[line_samples - 1 :: line_samples] + line_delay_s
    nearest = np.abs(np.arange(0.1, 11.9, 1 / frame_hz)[:, None] - arrival).argmin(axis=1)
    kept = nearest[np.concatenate([[True], np.diff(nearest) > 0])]
    lines = lines_of([list(range(k * line_samples, (k + 1) * line_samples)) for k in kept.tolist()], wave(t))
    return recorded(path, arrival[kept], lines)


def test_lines_slower_than_frames_are_all_there(tmp_path: Path) -> None:
    signal = read_ecg_field(plus_recording(tmp_path / "a.igs.mha", line_samples=25, frame_hz=30.0))
    assert not np.isnan(signal.samples).any()
    assert time_error_s(signal) < 0.006  # the delay of the line is not known


def test_of_lines_faster_than_frames_some_are_missing(tmp_path: Path) -> None:
    """31.25 lines a second, 30 frames: every 25th line found no frame."""
    signal = read_ecg_field(plus_recording(tmp_path / "a.igs.mha", line_samples=16, frame_hz=30.0))
    assert 0.02 < np.isnan(signal.samples).mean() < 0.06
    assert time_error_s(signal) < 0.007


def test_single_values_at_the_frame_rate_are_too_few(tmp_path: Path) -> None:
    path = plus_recording(tmp_path / "a.igs.mha", line_samples=1, frame_hz=30.0)
    with pytest.raises(UnreadableFileError, match="30 samples per second; needed 100: PLUS keeps"):
        read_ecg_field(path)


def test_a_line_that_stands_in_two_frames_counts_once(tmp_path: Path) -> None:
    """As a recorder does that stamps frames itself."""
    t = np.arange(5000) / RATE_HZ
    stamps = np.arange(0.05, 9.9, 0.04)
    lines = [line for line in lines_of(batched(t, stamps), wave(t)) for _ in range(2)]
    twice = np.column_stack([stamps, stamps + 0.02]).ravel()
    signal = read_ecg_field(recorded(tmp_path / "a.igs.mha", twice, lines))
    assert len(signal) == pytest.approx(4930, abs=20)
    assert time_error_s(signal) < 0.003


# ------------------------------------------------------------------ which field, and refusals


STAMPS = np.arange(0.05, 1.3, 0.04)
FLAT: list[str | None] = ["0.1 0.2 0.3 0.4 0.5 0.6 0.7 0.8"] * len(STAMPS)


def test_the_field_is_found_by_its_name_or_named(tmp_path: Path) -> None:
    t = np.arange(5000) / RATE_HZ
    stamps = np.arange(0.05, 9.9, 0.04)
    path = recorded(tmp_path / "a#1.igs.mha", stamps, lines_of(batched(t, stamps), wave(t)), name="LeadIIecg")
    text = path.read_text().replace("Seq_Frame0000_T", "Seq_Frame0000_Depth = 70\nSeq_Frame0000_T")
    path.write_text(text)
    found = [
        read_ecg(spec) for spec in (str(path), f"plus:{path}", f"plus:{path}#LeadIIecg", f"{path}#LeadIIecg")
    ]
    assert all(signal.leads == ("LeadIIecg",) for signal in found)
    facts = describe(str(path)).facts
    assert facts["numeric_fields"] == ["Depth", "LeadIIecg"]
    assert facts["ecg"]["LeadIIecg"]["rate_hz"] == pytest.approx(500, rel=1e-3)
    with pytest.raises(
        UnreadableFileError, match=r"has no field 'Ecg'; give .* plus:FILE#FIELD: Depth, Lead"
    ):
        read_ecg(f"plus:{path}#Ecg")


def test_several_fields_and_none(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.igs.mha", STAMPS, FLAT, name="EcgII")
    text = path.read_text()
    path.write_text(text + "")
    two = text.replace("Seq_Frame0003_T", "Seq_Frame0003_EcgV1 = 0.2\nSeq_Frame0003_T")
    path.write_text(two)
    with pytest.raises(UnreadableFileError, match=r"has 2 fields of an ECG; give .*: EcgII, EcgV1"):
        read_ecg_field(path)
    path.write_text(text.replace("EcgII", "Force"))
    with pytest.raises(UnreadableFileError, match=r"no field whose name contains 'ecg'; give .*: Force"):
        read_ecg_field(path)
    path.write_text(text.replace("EcgII", "Note").replace("0.1", "fine"))
    with pytest.raises(UnreadableFileError, match="no numeric fields"):
        read_ecg_field(path)


@pytest.mark.parametrize(
    ("line", "extra", "message"),
    [
        ("512,513", "", "decimal commas or twice as many"),
        ("0,1 0,2 0,3", "", "decimal commas or twice as many"),
        ("ready", "", "has no field whose name contains 'ecg'"),
        ("1 2 3", "EcgDataLeads = II V1\n", "3 values; needed a multiple of its 2 leads"),
        ("1 2 3 4 5 6 7 8", "EcgDataRate = fast\n", "EcgDataRate is 'fast'"),
        ("1 1 1 1 1 1 1 1", "EcgDataRate = 500\n", "500 Hz, but 200 Hz"),
    ],
)
def test_what_cannot_be_meant_is_refused(tmp_path: Path, line: str, extra: str, message: str) -> None:
    path = recorded(tmp_path / "a.igs.mha", STAMPS, [line] * len(STAMPS), extra=extra)
    with pytest.raises(UnreadableFileError, match=message):
        read_ecg_field(path)


def test_decimal_commas_between_semicolons(tmp_path: Path) -> None:
    t = np.arange(5000) / RATE_HZ
    stamps = np.arange(0.05, 9.9, 0.04)
    lines = [(line or "").replace(".", ",") for line in lines_of(batched(t, stamps), wave(t), ";")]
    assert time_error_s(read_ecg_field(recorded(tmp_path / "a.igs.mha", stamps, [*lines]))) < 0.003


def test_garbled_lines_are_missing_samples(tmp_path: Path) -> None:
    t = np.arange(5000) / RATE_HZ
    stamps = np.arange(0.05, 9.9, 0.04)
    lines = lines_of(batched(t, stamps), wave(t))
    lines[50] = "0.1 0.@2"
    signal = read_ecg_field(recorded(tmp_path / "a.igs.mha", stamps, lines))
    assert np.isnan(signal.samples).sum() == pytest.approx(20, abs=1)


def test_too_few_frames_and_no_stamps(tmp_path: Path) -> None:
    path = recorded(tmp_path / "a.igs.mha", STAMPS[:5], FLAT[:5])
    with pytest.raises(UnreadableFileError, match="not enough to estimate their times"):
        read_ecg_field(path)
    path.write_text(re.sub(r"Seq_Frame\d+_Timestamp.*\n", "", path.read_text()))
    with pytest.raises(UnreadableFileError, match="have no time stamp"):
        read_ecg_field(path)


def test_a_clock_that_restarts_ends_the_ecg(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    t = np.arange(5000) / RATE_HZ
    stamps = np.arange(0.05, 9.9, 0.04)
    lines = lines_of(batched(t, stamps), wave(t))
    stamps[200:] -= 6.0
    signal = read_ecg_field(recorded(tmp_path / "a.igs.mha", stamps, lines))
    assert signal.t_s[-1] == pytest.approx(0.05 + 199 * 0.04, abs=0.01)
    assert "where its clock restarts" in caplog.text
