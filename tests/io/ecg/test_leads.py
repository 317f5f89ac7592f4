"""Which channels of a recording are taken as an ECG, and what contradicts itself in one."""

import gzip
import json
import logging
import math
from collections.abc import Callable
from pathlib import Path

import edfio
import numpy as np
import pytest

from dvf_ig.core import FloatArray, UnreadableFileError
from dvf_ig.io import read_ecg
from dvf_ig.io.ecg.leads import Channel

RATE_HZ = 200.0
T_S = np.arange(1200) / RATE_HZ
BEAT = (T_S + 0.4) % 0.8 - 0.4
MV = np.round(np.exp(-0.5 * (BEAT / 0.012) ** 2), 4)
WAVE = np.round(np.sin(5.0 * T_S), 4)

NAMES = {
    "ecg": "ECG EKG ecg1 EKG2 I II III aVR AVF aVL V1 V6 V3R MLII MLIII MV2 MCL1 CM5 V VX DII|Lead I"
    "|ECG Lead II|EEG EKG1-REF|mod.V1|ECG1-ECG2|Shimmer_ECG_LL-RA_24BIT_CAL|A-S|V,|-aVR|ecg_raw|EcgData"
    "|Elektrokardiogramm",
    "other": "PLETH PPG SpO2 ABP ART CVP RESP RSP EDA EMG EOG Trigger Marker Status HR|Heart Rate|Resp. Imp."
    "|ECG Trigger|ECG quality|ECG_R_Peaks|ecgRate|EEG C4-A1|Pulse|Airflow|EDF Annotations|ECG_P_Onsets"
    "|ST-II|ECG Pacer",
    "unknown": "signal 0|Ch1|Channel 2|X|CS12",
    "cardiac": "cardiac",
}


@pytest.mark.parametrize("kind", NAMES)
def test_names_of_channels(kind: str) -> None:
    first, *rest = NAMES[kind].split("|")
    names = [*(first.split() if kind != "unknown" else [first]), *rest]
    assert {name: Channel(name, "mV").kind for name in names} == dict.fromkeys(names, kind)
    assert {Channel(name, "mmHg").kind for name in names} == {"other"}


def table(path: Path, header: str, *columns: FloatArray) -> str:
    rows = (",".join(map(repr, row)) for row in np.column_stack([T_S, *columns]).tolist())
    path.write_text("\n".join([header, *rows]) + "\n")
    return f"csv:{path}"


def test_leads_of_a_table(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    spec = table(tmp_path / "a.csv", "Time [s],ECG,RSP,Trigger", MV, WAVE, np.full(len(MV), 5.0))
    signal = read_ecg(spec)
    assert (signal.leads, signal.left_out) == (("ECG",), ("RSP", "Trigger"))
    assert "ECG is ECG; left out: RSP, Trigger" in caplog.text
    np.testing.assert_array_equal(signal.samples[:, 0], MV)
    assert read_ecg(spec, lead="rsp").leads == ("RSP",)
    with pytest.raises(UnreadableFileError, match=r"has no lead 'V9'; it has ECG, RSP, Trigger .ecg\.lead."):
        read_ecg(spec, lead="V9")


def test_a_table_of_unnamed_columns_asks(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    spec = table(tmp_path / "a.csv", "t_s,A,B", MV, WAVE)
    with pytest.raises(UnreadableFileError, match="names no channel as an ECG, and 2 may be one: A, B"):
        read_ecg(spec)
    assert read_ecg(spec, lead="A").leads == ("A",)
    assert read_ecg(table(tmp_path / "b.csv", "t_s,A,RSP", MV, WAVE)).leads == ("A",)
    assert "no channel is named as an ECG; A is taken as one" in caplog.text
    with pytest.raises(UnreadableFileError, match="has no channel of an ECG, only Pleth, RSP"):
        read_ecg(table(tmp_path / "c.csv", "t_s,Pleth,RSP", MV, WAVE))


def edf(path: Path, *signals: tuple[str, str, int]) -> str:
    edfio.Edf(
        [
            edfio.EdfSignal(
                np.resize(MV, 6 * rate), rate, label=label, physical_dimension=unit, physical_range=(-2, 2)
            )
            for label, unit, rate in signals
        ]
    ).write(path)
    return f"edf:{path}"


def test_leads_of_an_edf_have_their_own_rate(tmp_path: Path) -> None:
    spec = edf(tmp_path / "a.edf", ("Pleth", "uV", 100), ("EKG", "mV", 200), ("SpO2", "%", 1))
    signal = read_ecg(spec)
    assert (signal.leads, signal.rate_hz, signal.left_out) == (("EKG",), 200.0, ("Pleth", "SpO2"))
    with pytest.raises(UnreadableFileError, match="SpO2 is in '%', which is no voltage"):
        read_ecg(spec, lead="SpO2")
    with pytest.raises(
        UnreadableFileError, match=r"do not share one rate .II .mV. at 200 Hz, V1 .mV. at 100"
    ):
        read_ecg(edf(tmp_path / "b.edf", ("II", "mV", 200), ("V1", "mV", 100)))


def test_an_edf_with_24_bits_or_a_unit_in_utf8(tmp_path: Path) -> None:
    edfio.Bdf(
        [edfio.BdfSignal(1000 * MV, 200, label="ECG", physical_dimension="uV", physical_range=(-3000, 3000))]
    ).write(tmp_path / "a.bdf")
    np.testing.assert_allclose(read_ecg(str(tmp_path / "a.bdf")).samples[:, 0], MV, atol=1e-6)
    data = Path(edf(tmp_path / "b.edf", ("ECG", "uV", 200)).removeprefix("edf:")).read_bytes()
    (tmp_path / "b.edf").write_bytes(data.replace(b"uV      ", "µV     ".encode(), 1))
    np.testing.assert_allclose(read_ecg(str(tmp_path / "b.edf")).samples[:, 0], MV / 1000, atol=1e-7)


def wfdb(folder: Path, header: str, *columns: FloatArray) -> str:
    (folder / "r.hea").write_bytes(header.encode("latin-1"))
    (folder / "r.dat").write_bytes(np.rint(1000 * np.column_stack(columns)).astype("<i2").tobytes())
    return f"wfdb:{folder / 'r'}"


LINE = "r.dat 16{} 1000/{} 16 0 0 0 0 {}\n"


@pytest.mark.parametrize(
    ("header", "columns", "rate_hz"),
    [
        (f"r 3 200\n{LINE.format('', 'mV', 'II')}{LINE.format('', 'mmHg', 'ABP')}"
         f"{LINE.format('', 'NU', 'PLETH')}", 3, 200),
        (f"r 1 1 6\n{LINE.format('x200', 'mV', 'II')}", 1, 200),
        (f"r 1 50 300\n{LINE.format('x4', 'mV', 'II')}", 1, 200),
        (f"r 1 200 1200 05-May-2020 09:49:17\n{LINE.format('', 'mV', 'II')}# Größe\n", 1, 200),
        (f"r.mat 1 200 1200\n{LINE.format('', 'mV', 'II')}", 1, 200),
    ],
)  # fmt: skip
def test_wfdb_records_of_wards_and_challenges(
    tmp_path: Path, header: str, columns: int, rate_hz: float
) -> None:
    pytest.importorskip("wfdb")
    signal = read_ecg(wfdb(tmp_path, header, *[MV, 80 * WAVE / 100, WAVE][:columns]))
    assert (signal.leads, signal.rate_hz, signal.unit) == (("II",), rate_hz, "mV")
    np.testing.assert_allclose(signal.samples[:, 0], MV, atol=6e-4)


def test_a_wfdb_record_whose_files_are_links(tmp_path: Path) -> None:
    pytest.importorskip("wfdb")
    (tmp_path / "store").mkdir()
    (tmp_path / "here").mkdir()
    wfdb(tmp_path / "store", f"r 1 200\n{LINE.format('', 'mV', 'II')}", MV)
    for name in ("r.hea", "r.dat"):
        (tmp_path / "here" / name).symlink_to(tmp_path / "store" / name)
    assert len(read_ecg(f"wfdb:{tmp_path / 'here' / 'r'}")) == len(MV)
    (tmp_path / "here" / "r.hea").unlink()
    (tmp_path / "here" / "r.hea").write_bytes((tmp_path / "store" / "r.hea").read_bytes())
    with pytest.raises(UnreadableFileError, match="a link to a file outside its folder"):
        read_ecg(f"wfdb:{tmp_path / 'here' / 'r'}")


# ------------------------------------------------------------------ exports


def labchart(t: float, v: float) -> str:
    return f"{t:.3f}\t{v}\t0.5" + ("\t#* paused" if t == 1.0 else "")


EXPORTS: dict[str, tuple[str, Callable[[float, float], str]]] = {
    "LabChart": (
        "Interval=\t0.005 s\nTimeFormat=\tStartOfBlock\nDateFormat=\t\nChannelTitle=\tECG\tResp\n"
        "Range=\t10.000 mV\t1.000 V\n",
        labchart,
    ),
    "Polar": (
        "Phone timestamp;sensor timestamp [ns];timestamp [ms];ecg [mV]\n",
        lambda t, v: f"2020-10-15T12:34:{50 + int(t)}.350;{10**17 + round(1e9 * t)};{1000 * t:.1f};{v}",
    ),
    "Apple": (
        'Name,Someone\nSoftware Version,1.90\nDevice,"Watch4,2"\nSample Rate,200 hertz\n'
        "Lead,Lead I\nUnit,mV\n\n",
        lambda t, v: f"{v}",
    ),
    "OpenSignals": (
        '# OpenSignals Text File Format\n# {"98:D3": {"sensor": ["ECG"], "column": ["nSeq", "I1", "A1"], '
        '"sampling rate": 200}}\n# EndOfHeader\n',
        lambda t, v: f"{round(200 * t) % 16}\t1\t{v}\t",
    ),
    "a heading in a comment": ("# fs = 200 Hz\n# ECG RESP\n", lambda t, v: f"{v} 0.5"),
    "AM and PM": (
        "Time,ECG\n",
        lambda t, v: f"{'11:59' if t < 3 else '12:00'}:{(57 + t) % 60:06.3f} {'AM' if t < 3 else 'PM'},{v}",
    ),
    "day, month, year": (
        "sep=;\nTime;ECG\n",
        lambda t, v: (
            f"{30 + (t >= 3)}.03.2024 {'23:59' if t < 3 else '00:00'}:{(57 + t) % 60:06.3f};{v}".replace(
                ".", ","
            ).replace(",03,2024", ".03.2024")
        ),
    ),
    "minutes": ("time [min],ECG [mV]\n", lambda t, v: f"{t / 60:.9f},{v}"),
}


@pytest.mark.parametrize("kind", EXPORTS)
def test_exports_of_recorders(tmp_path: Path, kind: str) -> None:
    header, row = EXPORTS[kind]
    rows = [row(t, v) for t, v in zip(T_S.tolist(), MV.tolist(), strict=True)]
    (tmp_path / "a.csv").write_text(header + "\n".join(rows) + "\n", encoding="utf-8")
    signal = read_ecg(str(tmp_path / "a.csv"))
    np.testing.assert_array_equal(signal.samples[:, -1], MV)
    assert signal.rate_hz == pytest.approx(200, rel=1e-4)
    assert signal.unit == "mV"


@pytest.mark.parametrize("encoding", ["utf-16", "cp1252"])
def test_tables_that_a_spreadsheet_saved(
    tmp_path: Path, encoding: str, caplog: pytest.LogCaptureFixture
) -> None:
    rows = [
        f"{1000 * t:.0f};{1000 * v}".replace(".", ",") for t, v in zip(T_S.tolist(), MV.tolist(), strict=True)
    ]
    (tmp_path / "a.csv").write_text("\n".join(["Zeit [ms];EKG (µV)", *rows]), encoding=encoding)
    signal = read_ecg(str(tmp_path / "a.csv"))
    assert (signal.leads, signal.unit, signal.rate_hz) == (("EKG",), "µV", 200.0)
    assert ("Windows-1252" in caplog.text) is (encoding == "cp1252")


def test_a_bids_recording_uses_its_sidecar(tmp_path: Path) -> None:
    rows = "\n".join(f"{v}\t{w}" for v, w in zip(MV.tolist(), WAVE.tolist(), strict=True))
    with gzip.open(tmp_path / "a_physio.tsv.gz", "wt") as file:
        file.write(rows)
    sidecar = {"SamplingFrequency": 200, "StartTime": -2.5, "Columns": ["cardiac", "respiratory"]}
    (tmp_path / "a_physio.json").write_text(json.dumps(sidecar))
    spec = str(tmp_path / "a_physio.tsv.gz")
    signal = read_ecg(spec)
    assert (signal.leads, signal.rate_hz, signal.start_s) == (("cardiac",), 200.0, -2.5)
    np.testing.assert_array_equal(signal.samples[:, 0], MV)
    with pytest.raises(UnreadableFileError, match="states 200 Hz, but --rate is 400 Hz"):
        read_ecg(spec, 400.0)
    (tmp_path / "a_physio.json").write_text(json.dumps({**sidecar, "Columns": ["cardiac"]}))
    with pytest.raises(UnreadableFileError, match=r"has 2 columns, but a_physio\.json names 1"):
        read_ecg(spec)
    (tmp_path / "a_physio.tsv.gz").write_bytes((tmp_path / "a_physio.tsv.gz").read_bytes()[:-30])
    with pytest.raises(UnreadableFileError, match="not a whole gzip file"):
        read_ecg(spec)


@pytest.mark.parametrize("leads", [1, 2])
def test_a_log_of_a_scanner(tmp_path: Path, leads: int) -> None:
    values = np.column_stack([np.rint(2048 + 400 * MV), np.rint(3000 + 200 * MV)])[:, :leads].ravel()
    words = [f"{v:.0f}" for v in values]
    words.insert(100, "5000")
    footer = "ECG  Freq Per: 75 800\nLogStartMDHTime:  37000000\nLogStopMDHTime:   37006000\n6003\n"
    (tmp_path / "a.ecg").write_text(f"1 2 40 280 5002 LOGVERSION 102 6002 {' '.join(words)} 5003\n{footer}")
    signal = read_ecg(str(tmp_path / "a.ecg"))
    assert (signal.rate_hz, len(signal), len(signal.leads)) == (200.0, len(MV), leads)
    with pytest.raises(UnreadableFileError, match="1200 samples of each lead in 6 s, 200 Hz"):
        read_ecg(str(tmp_path / "a.ecg"), 400.0)


# ------------------------------------------------------------------ what cannot be


@pytest.mark.parametrize(
    ("header", "scale", "sentence"),
    [
        ("t_s,ECG [V]", 1.0, "lead ECG swings by 1e+03 mV from beat to beat"),
        ("t_s,ECG [uV]", 1.0, "lead ECG swings by 0.001 mV from beat to beat"),
        ("t_s,ECG", 1000.0, "its numbers are too large for mV: they are read as counts"),
    ],
)
def test_voltages_that_no_heart_gives_are_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, header: str, scale: float, sentence: str
) -> None:
    with caplog.at_level(logging.WARNING):
        read_ecg(table(tmp_path / "a.csv", header, np.rint(scale * MV) if scale > 1 else MV))
    assert sentence in caplog.text


def test_two_columns_of_times_must_agree(tmp_path: Path) -> None:
    rows = (f"{t!r},{2000 * t!r},{v!r}" for t, v in zip(T_S.tolist(), MV.tolist(), strict=True))
    (tmp_path / "a.csv").write_text("\n".join(["time [s],timestamp [ms],ECG", *rows]))
    with pytest.raises(
        UnreadableFileError, match="'time' has 200 samples per second, column 'timestamp' 100"
    ):
        read_ecg(str(tmp_path / "a.csv"))
    assert math.isclose(read_ecg(table(tmp_path / "b.csv", "t_s,ECG", MV)).rate_hz, RATE_HZ)


def test_a_column_that_counts_is_no_time(tmp_path: Path) -> None:
    """As pandas saves a table: the index has no name."""
    (tmp_path / "a.csv").write_text(",ECG\n" + "".join(f"{i},{v}\n" for i, v in enumerate(MV)))
    with pytest.raises(UnreadableFileError, match="no column of times"):
        read_ecg(f"csv:{tmp_path / 'a.csv'}")
    assert read_ecg(f"csv:{tmp_path / 'a.csv'}", RATE_HZ).rate_hz == RATE_HZ


def test_columns_of_words_are_left_out_by_name(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    rows = "".join(f"2024-03-01,{t},{v},N\n" for t, v in zip(T_S, MV, strict=True))
    (tmp_path / "a.csv").write_text(f"Date,Time (s),II (mV),Note\n{rows}")
    signal = read_ecg(f"csv:{tmp_path / 'a.csv'}")
    np.testing.assert_array_equal(signal.samples[:, 0], MV)
    assert signal.rate_hz == pytest.approx(RATE_HZ)
    assert "the columns Date, Note hold words and are left out" in caplog.text


@pytest.mark.parametrize(
    ("header", "note"),
    [
        ("t,Finger", "no channel is named as an ECG; Finger is taken as one"),
        ("t,II,II", "several channels are named ii"),
    ],
)
def test_a_doubtful_choice_of_leads_is_said(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, header: str, note: str
) -> None:
    more = ",0.5" * (header.count(",") - 1)
    rows = "".join(f"{t},{v}{more}\n" for t, v in zip(T_S, MV, strict=True))
    (tmp_path / "a.csv").write_text(f"{header}\n{rows}")
    read_ecg(f"csv:{tmp_path / 'a.csv'}")
    assert note in caplog.text


@pytest.mark.parametrize("missing", [-9999.0, -32768.0, 99999.0])
def test_numbers_that_stand_for_missing_samples(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, missing: float
) -> None:
    lost = (T_S > 2) & (T_S < 3)
    rows = "".join(f"{t},{missing if gone else v}\n" for t, v, gone in zip(T_S, MV, lost, strict=True))
    (tmp_path / "a.csv").write_text(f"t,II\n{rows}")
    samples = read_ecg(f"csv:{tmp_path / 'a.csv'}").samples[:, 0]
    np.testing.assert_array_equal(np.isnan(samples), lost)
    np.testing.assert_array_equal(samples[~lost], MV[~lost])
    assert "are taken as missing" in caplog.text
