"""ECG files that are damaged, cut off or made to harm; those that are whole as the packages read them."""

import logging
from pathlib import Path

import edfio
import numpy as np
import pytest

from dvf_ig.core import UnreadableFileError
from dvf_ig.io import read_annotations, read_ecg, read_triggers
from dvf_ig.io.ecg.beat_annotations import BEAT_SYMBOLS

SAMPLES = np.arange(2000).astype("<i2").tobytes()


def edf(path: Path, cut: int = 0, records: int = 10, **changes: str) -> str:
    """Ten records of a second of two leads, 250 Hz; the header's fields can be put in by their names."""
    fields = {"version": "0", "start": "", "size": "768", "form": "", "count": str(records), "lasts": "1"}
    fields |= {"leads": "2", "label": "ECG II", "unit": "mV", "low": "-5", "high": "5", "samples": "250"}
    fields |= {"digital_low": "-32768", "digital_high": "32767"} | changes
    widths = {"version": 8, "start": 176, "size": 8, "form": 44, "count": 8, "lasts": 8, "leads": 4}
    head = "".join(fields[name].ljust(width) for name, width in widths.items())
    each = {"label": 16, "": 80, "unit": 8, "low": 8, "high": 8, "digital_low": 8, "digital_high": 8}
    for name, width in [*each.items(), ("", 80), ("samples", 8), ("", 32)]:
        head += fields.get(name, "").ljust(width) * 2
    data = head.encode() + (np.arange(5000) % 200).astype("<i2").tobytes()
    path.write_bytes(data[: len(data) - cut])
    return f"edf:{path}"


def test_edf_as_its_package_reads_it(tmp_path: Path) -> None:
    found = read_ecg(edf(tmp_path / "a.edf"))
    signals = edfio.read_edf(tmp_path / "a.edf").signals
    np.testing.assert_allclose(found.samples, np.column_stack([s.data for s in signals]), atol=1e-12)
    assert (found.rate_hz, found.leads) == (250.0, ("ECG II", "ECG II"))


@pytest.mark.parametrize(
    ("cut", "count", "seconds", "sentence"),
    [
        (1, "10", 9, "it has 9 of 10 records: 9 s are read; the last 1 s are missing"),
        (2 * 500 * 3 + 17, "10", 6, "it has 6 of 10 records"),
        (0, "99999999", 10, "it has 10 of 99999999 records"),
        (10, "-1", 9, "does not say how many records it has"),
    ],
)
def test_the_whole_records_of_an_edf_are_read_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, cut: int, count: str, seconds: int, sentence: str
) -> None:
    whole = read_ecg(edf(tmp_path / "whole.edf"))
    with caplog.at_level(logging.WARNING):
        found = read_ecg(edf(tmp_path / "a.edf", cut, count=count))
    np.testing.assert_array_equal(found.samples, whole.samples[: 250 * seconds])
    assert sentence in caplog.text


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"lasts": "0"}, "records last 0 s"),
        ({"lasts": "nan"}, "the value 'nan'"),
        ({"lasts": "1e99"}, "the value '1e99'"),
        ({"count": "3"}, "longer than its header says"),
        ({"count": "0"}, "longer than its header says"),
        ({"count": "many"}, "number of records"),
        ({"leads": "0"}, "number of leads"),
        ({"leads": "999"}, "number of leads|truncated"),
        ({"samples": "99999999"}, "samples a record"),
        ({"samples": "-3"}, "samples a record"),
        ({"low": "nan"}, "the value 'nan'"),
        ({"high": "1e300"}, "the value '1e300'"),
        ({"low": "5"}, "same smallest and largest"),
        ({"digital_low": "32767"}, "same smallest and largest"),
        ({"unit": "degC"}, "no channel of an ECG, only ECG II .degC. at 250 Hz"),
        ({"form": "EDF+D"}, "interruptions"),
        ({"size": "512"}, "says that it has 512 bytes, but 2 signals need 768"),
        ({"digital_high": "70000"}, "which 16 bits do not hold"),
        ({"version": "garbage"}, "not a readable EDF"),
    ],
)
def test_edf_headers(tmp_path: Path, changes: dict[str, str], sentence: str) -> None:
    with pytest.raises(UnreadableFileError, match=sentence):
        read_ecg(edf(tmp_path / "a.edf", **changes))


def test_an_edf_with_annotations_is_continuous_by_their_times(tmp_path: Path) -> None:
    lead = edfio.EdfSignal(np.sin(np.arange(2500) / 20), 250, label="ECG", physical_dimension="mV")
    edfio.Edf([lead], annotations=[edfio.EdfAnnotation(1.5, None, "start")]).write(tmp_path / "a.edf")
    assert read_ecg(str(tmp_path / "a.edf")).leads == ("ECG",)
    data = (tmp_path / "a.edf").read_bytes()
    (tmp_path / "a.edf").write_bytes(data.replace(b"+6\x14\x14", b"+8\x14\x14"))
    with pytest.raises(UnreadableFileError, match="has interruptions, first before record 7 of 10"):
        read_ecg(str(tmp_path / "a.edf"))


def wfdb_record(folder: Path, header: str, samples: bytes = SAMPLES) -> str:
    (folder / "r.hea").write_text(header)
    (folder / "r.dat").write_bytes(samples)
    return f"wfdb:{folder / 'r'}"


@pytest.mark.parametrize(
    ("header", "sentence"),
    [
        ("r 1 250 100000000000\nr.dat 16 200 16 0 0 0 0 II\n", "states 100000000000 samples"),
        ("r 1 250 2001\nr.dat 16 200 16 0 0 0 0 II\n", "not a readable WFDB record .truncated: 2000 of 2001"),
        ("r 1 250 200\n/etc/passwd 16 200 16 0 0 0 0 II\n", "its own folder"),
        ("r 1 250 200\n../r.dat 16 200 16 0 0 0 0 II\n", "its own folder"),
        ("r 1 1e300 2000\nr.dat 16 200 16 0 0 0 0 II\n", "record line"),
        ("r 9999 250 2000\nr.dat 16 200 16 0 0 0 0 II\n", "9999 leads"),
        ("r 2 250 2000\nr.dat 16 200 16 0 0 0 0 II\n", "lines of 1 of 2 signals"),
        ("r 1 250 2000\nr.dat 17 200 16 0 0 0 0 II\n", "line of a signal"),
        ("r 1 250 2000\nr.dat 516 200 16 0 0 0 0 II\n", "not a readable WFDB record"),
        ("r 1 250 2000\nr.dat 16x0 200/mV\n", "the line of a signal is 'r.dat 16x0 200/mV'"),
        ("r 1 250 2000\nr.dat 16x00\n", "the line of a signal is 'r.dat 16x00'"),
        ("r 1 250 2000\nr.dat 16x-1 200/mV\n", "the line of a signal"),
        ("r 1 250 2000\nr.dat 16x9999 200/mV\n", "truncated: 0 of 2000"),
        ("r 1 250 20000000\nr.dat 516x9999 200/mV\n", "states 199980000000 samples"),
        ("r 1 250 2000\nr.dat 16:999999999 200/mV\n", "begins 999999999 samples late"),
        ("r 1 250\nr.dat 16:2000 200/mV\n", "begins 2000 samples late"),
        ("r 1 250 2000\nr.dat 16+999999999 200/mV\n", "truncated: 0 of 2000"),
        ("r 1 250\nr.dat 16+999999999 200/mV\n", "not a readable WFDB record"),
        ("r 1 250 2000\nr.dat 16 1e400/mV\n", "the gain of a signal is 1e400"),
        ("r 1 250 2000\nr.dat 16 200(99999999999999999999)/mV\n", "the line of a signal"),
        ("r/2 1 250 2000\nr 1000\nr 1000\n", "has segments itself"),
        ("r/2 1 250 2000\nr 1000\nr 99999\n", "states 2000 samples, its segments 100999"),
        ("r/2 1 250\nr 1000\n~ 199999000\n", "states 200000000 samples, but its segments hold 1000"),
        ("r/2 1 250\nr 1000\nr\n", "the line of a segment is 'r'"),
        ("r 1 250 2000\nr.dat 16 nan 16 0 0 0 0 II\n", "r"),
        ("", "record line is 'empty'"),
    ],
)
def test_wfdb_headers(tmp_path: Path, header: str, sentence: str) -> None:
    assert len(read_ecg(wfdb_record(tmp_path, "r 1 250 2000\nr.dat 16 200 16 0 0 0 0 II\n"))) == 2000
    with pytest.raises(UnreadableFileError, match=sentence):
        read_ecg(wfdb_record(tmp_path, header))


@pytest.mark.parametrize("gain", ["", " 0", " 0/mV", " 0(0)/mV 16 0 0 0 0", " 200", " 200/"])
def test_wfdb_signals_that_state_no_gain_or_unit(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, gain: str
) -> None:
    """WFDB header(5): a gain that is absent or 0 means 200 units in a mV, not calibrated."""
    with caplog.at_level(logging.WARNING):
        found = read_ecg(wfdb_record(tmp_path, f"r 1 250 2000\nr.dat 16{gain}\n"))
    np.testing.assert_allclose(found.samples[:, 0], np.arange(2000) / 200.0)
    assert (found.rate_hz, found.leads, found.unit) == (250.0, ("signal 0",), "mV")
    assert ("is not calibrated" in caplog.text) is ("200" not in gain)


def segments(folder: Path, leads: str, **headers: str) -> str:
    """A record of a layout and two segments that hold lead II alone."""
    named = {"a": "a 1 250 1000", "b": "b 1 250 1000"} | headers
    for number, (name, line) in enumerate(named.items()):
        (folder / f"{name}.hea").write_text(f"{line}\n{name}.dat 16 0 16 0 0 0 0 II\n")
        (folder / f"{name}.dat").write_bytes(SAMPLES[2000 * number : 2000 * (number + 1)])
    layout = "".join(f"~ 0 0 16 0 0 0 0 {lead}\n" for lead in leads.split())
    (folder / "layout.hea").write_text(f"layout {len(leads.split())} 250 0\n{layout}")
    (folder / "r.hea").write_text(f"r/3 {len(leads.split())} 250 2000\nlayout 0\na 1000\nb 1000\n")
    return f"wfdb:{folder / 'r'}"


def test_a_lead_that_no_segment_of_a_record_holds_is_a_gap(tmp_path: Path) -> None:
    """The package knows no unit of it."""
    pytest.importorskip("wfdb")
    found = read_ecg(segments(tmp_path, "II V"))
    assert found.leads == ("II", "V")
    np.testing.assert_allclose(found.samples[:, 0], np.arange(2000) / 200.0)
    assert np.isnan(found.samples[:, 1]).all()
    with pytest.raises(UnreadableFileError, match="holds no sample of I, V, only gaps"):
        read_ecg(segments(tmp_path, "I V"))


@pytest.mark.parametrize(
    ("line", "sentence"),
    [("b 1 500 1000", "states 500 Hz, its record 250 Hz"), ("b 1 250 900", "states 900 samples")],
)
def test_segments_that_contradict_their_record(tmp_path: Path, line: str, sentence: str) -> None:
    with pytest.raises(UnreadableFileError, match=sentence):
        read_ecg(segments(tmp_path, "II", b=line))


@pytest.mark.filterwarnings("ignore")
def test_annotations_as_the_package_reads_them(data_dir: Path) -> None:
    wfdb = pytest.importorskip("wfdb")
    for file in sorted((data_dir / "mitdb-ds1").glob("*.atr")):
        notes = wfdb.rdann(str(file.with_suffix("")), "atr")
        beats = [(s / 360, y) for s, y in zip(notes.sample, notes.symbol, strict=True) if y in BEAT_SYMBOLS]
        found = read_annotations(f"wfdb:{file}")
        assert list(zip(found.t_s.tolist(), found.symbols, strict=True)) == beats
        rhythms = [(s / 360, t) for s, t in zip(notes.sample, notes.aux_note, strict=True) if t[:1] == "("]
        assert list(found.rhythms) == [(s, t.strip("\0")[1:]) for s, t in rhythms]


@pytest.mark.parametrize("keep", [0, 1, 40, 2767, -139, -3, -2])
def test_annotations_that_are_cut_off_are_refused(data_dir: Path, tmp_path: Path, keep: int) -> None:
    for ending in ("hea", "atr"):
        data = (data_dir / "mitdb-ds1" / f"101.{ending}").read_bytes()
        (tmp_path / f"101.{ending}").write_bytes(data[:keep] if ending == "atr" else data)
    with pytest.raises(UnreadableFileError, match="truncated"):
        read_annotations(f"wfdb:{tmp_path / '101'}")


@pytest.mark.parametrize("value", ["inf", "-inf", "1e300", "1e10"])
def test_what_is_no_voltage(tmp_path: Path, value: str) -> None:
    rows = [f"{i / 250},{value if i == 7 else 0.1},nan" for i in range(100)]
    (tmp_path / "a.csv").write_text("t_s,II,V1\n" + "\n".join(rows))
    with pytest.raises(UnreadableFileError, match="needed finite values below 1e"):
        read_ecg(str(tmp_path / "a.csv"))


def test_leads_without_samples(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "a.csv").write_text("t_s,II,V1\n" + "\n".join(f"{i / 250},0.1,nan" for i in range(100)))
    assert read_ecg(str(tmp_path / "a.csv")).leads == ("II", "V1")
    assert "lead V1 holds no sample" in caplog.text
    (tmp_path / "b.csv").write_text("t_s,II\n" + "\n".join(f"{i / 250},nan" for i in range(100)))
    with pytest.raises(UnreadableFileError, match="holds no sample of II"):
        read_ecg(str(tmp_path / "b.csv"))


@pytest.mark.parametrize("row", ["nan", "inf", "1e300", "-1e300", "0.05"])
def test_trigger_times_that_cannot_be(tmp_path: Path, row: str) -> None:
    (tmp_path / "t.csv").write_text(f"0.1\n{row}\n2.0\n")
    with pytest.raises(UnreadableFileError, match=r"t\.csv"):
        read_triggers(tmp_path / "t.csv")


def test_a_digital_range_upside_down_is_named(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError, match="digital minimum of ECG II, 32767, is above its maximum"):
        read_ecg(edf(tmp_path / "a.edf", digital_low="32767", digital_high="-32768"))


def test_a_gap_without_a_layout_is_named(tmp_path: Path) -> None:
    wfdb_record(tmp_path, "r 1 250 2000\nr.dat 16 200 16 0 0 0 0 II\n")
    (tmp_path / "m.hea").write_text("m/3 1 250 4500\nr 2000\n~ 500\nr 2000\n")
    with pytest.raises(UnreadableFileError, match=r"has a gap .'~'. and no layout segment"):
        read_ecg(f"wfdb:{tmp_path / 'm'}")
