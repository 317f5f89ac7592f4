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


def breathing(path: Path, header: str, times: list[str]) -> str:
    rows = [f"{t},{np.sin(i / 9):.4f}" for i, t in enumerate(times)]
    path.write_text("\n".join([header, *rows]) + "\n")
    return f"csv:{path}"


@pytest.mark.parametrize(
    ("header", "times"),
    [
        ("time (min),Resp", [f"{(10 + i / 25) / 60:.9f}" for i in range(99)]),
        ("t_us,Resp", [f"{1e6 * (10 + i / 25):.0f}" for i in range(99)]),
        ("Zeit [s],Atmung", [f"{10 + i / 25:.2f}" for i in range(99)]),
        ("time,Resp", [f"00:00:{10 + i / 25:05.2f}" for i in range(99)]),
    ],
)
def test_times_of_breathing_in_any_unit(tmp_path: Path, header: str, times: list[str]) -> None:
    breath = read_respiration(breathing(tmp_path / "a.csv", header, times))
    np.testing.assert_allclose(breath.t_s, 10 + np.arange(99) / 25, atol=1e-6)


def test_breathing_across_midnight_loses_nothing(tmp_path: Path) -> None:
    times = [f"23:59:{59 + i / 25:05.2f}" for i in range(25)] + [f"00:00:{i / 25:05.2f}" for i in range(25)]
    breath = read_respiration(breathing(tmp_path / "a.csv", "time,Resp", times))
    np.testing.assert_allclose(np.diff(breath.t_s), 0.04, atol=1e-6)


@pytest.mark.parametrize(
    ("header", "step", "message"),
    [
        ("t_s,Resp", 40.0, r"times step by 40 s .* shows no breath; correct the unit"),
        ("t,Resp rate (bpm)", 0.04, "breaths per minute; needed what follows each breath"),
    ],
)
def test_what_shows_no_breath_is_refused(tmp_path: Path, header: str, step: float, message: str) -> None:
    with pytest.raises(UnreadableFileError, match=message):
        read_respiration(breathing(tmp_path / "a.csv", header, [f"{i * step:g}" for i in range(50)]))


def test_a_flat_channel_and_two_rates_are_refused(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("# sampling rate: 25 Hz\nResp\n" + "1\n2\n" * 20)
    assert read_respiration(f"csv:{tmp_path / 'a.csv'}").t_s[25] == 1.0
    with pytest.raises(UnreadableFileError, match="states 25 Hz, but --rate is 50 Hz"):
        read_respiration(f"csv:{tmp_path / 'a.csv'}", 50.0)
    (tmp_path / "a.csv").write_text("t,Resp\n" + "".join(f"{i / 25},1\n" for i in range(50)))
    with pytest.raises(UnreadableFileError, match="'Resp' never changes"):
        read_respiration(f"csv:{tmp_path / 'a.csv'}")


def test_a_marker_with_units_in_its_names_or_in_m(tmp_path: Path) -> None:
    rows = "".join(f"{i / 25},{np.sin(i / 9) / 200:.6f},0,0.9\n" for i in range(50))
    (tmp_path / "m.csv").write_text(f"t,x_m,y_m,z_m\n{rows}")
    marker = read_respiration(f"marker:{tmp_path / 'm.csv'}")
    assert np.ptp(marker.values[:, 0]) == pytest.approx(10.0, abs=0.1)
    (tmp_path / "m.csv").write_text(f"t,tx,ty,tz\n{rows}")
    with pytest.raises(UnreadableFileError, match="the poses are in m, not mm"):
        read_respiration(f"marker:{tmp_path / 'm.csv'}")
