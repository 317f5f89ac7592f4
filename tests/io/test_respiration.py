"""Recorded breathing: channels read back exactly, markers in decimal commas, and what is refused."""

from pathlib import Path

import numpy as np
import pytest

from dvf_ig.core import InvalidInputError, Signal, UnreadableFileError
from dvf_ig.io.respiration import read_respiration, write_channels


def test_channels_of_a_ventilator_read_back_exactly(tmp_path: Path) -> None:
    samples = np.random.default_rng(0).standard_normal((50, 2))
    write_channels(Signal(samples, 25.0, 3.0, ("pressure_cmh2o", "flow_l_per_s"), ""), tmp_path / "v.csv")
    flow = read_respiration(f"csv:{tmp_path / 'v.csv'}#flow_l_per_s")
    np.testing.assert_array_equal(flow.values[:, 0], samples[:, 1])
    np.testing.assert_array_equal(flow.t_s, 3.0 + np.arange(50) / 25.0)
    with pytest.raises(
        UnreadableFileError, match="has pressure_cmh2o, flow_l_per_s, of which one must be breathing"
    ):
        read_respiration(f"csv:{tmp_path / 'v.csv'}")
    with pytest.raises(UnreadableFileError, match="has no channel 'volume'; it has pressure_cmh2o"):
        read_respiration(f"csv:{tmp_path / 'v.csv'}#volume")


def test_a_marker_with_decimal_commas_and_a_last_row_of_zeros(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    rows = [
        '"Frame";"Timestamp";"x";"y";"z"',
        "0;0;-4,5;1;2",
        "6;100;-4,25;1;2",
        "12;200;-4;1;2",
        "0;0;0;0;0",
    ]
    (tmp_path / "marker.csv").write_text("\n".join(rows) + "\n")
    with pytest.raises(UnreadableFileError, match="no unit and step by 100; name the column Timestamp_ms"):
        read_respiration(f"marker:{tmp_path / 'marker.csv'}")
    with pytest.raises(UnreadableFileError, match="at 50 Hz neither s nor ms"):
        read_respiration(f"marker:{tmp_path / 'marker.csv'}", 50.0)
    marker = read_respiration(f"marker:{tmp_path / 'marker.csv'}", 10.0)
    np.testing.assert_array_equal(marker.t_s, [0.0, 0.1, 0.2])
    np.testing.assert_array_equal(marker.values[:, 0], [-4.5, -4.25, -4.0])
    assert "1 samples are not later" in caplog.text


def test_a_signal_of_a_wfdb_record_keeps_its_own_rate(tmp_path: Path) -> None:
    """An ECG of 100 Hz beside breathing of 25 Hz, four samples and one a frame, in 16 bits."""
    frames = np.empty((200, 5), dtype="<i2")
    frames[:, :4] = np.arange(800).reshape(200, 4)
    frames[:, 4] = np.arange(200)
    (tmp_path / "r.dat").write_bytes(frames.tobytes())
    lines = ["r 2 25 200", "r.dat 16x4 100/mV 16 0 0 0 0 II", "r.dat 16 10/NU 16 0 0 0 0 RESP"]
    (tmp_path / "r.hea").write_text("\n".join(lines) + "\n")
    breath = read_respiration(f"wfdb:{tmp_path / 'r'}")
    assert breath.name == "RESP"
    np.testing.assert_allclose(breath.t_s, np.arange(200) / 25.0)
    np.testing.assert_allclose(breath.values[:, 0], np.arange(200) / 10.0)


def test_a_table_without_times_needs_a_rate_and_other_kinds_are_refused(tmp_path: Path) -> None:
    (tmp_path / "r.csv").write_text("ECG,RSP\n1,2\n3,4\n5,6\n")
    with pytest.raises(UnreadableFileError, match="--rate"):
        read_respiration(f"csv:{tmp_path / 'r.csv'}")
    assert read_respiration(f"csv:{tmp_path / 'r.csv'}", 10.0).name == "RSP"
    with pytest.raises(InvalidInputError, match="names no recording of breathing"):
        read_respiration(f"dicom:{tmp_path / 'r.csv'}")
