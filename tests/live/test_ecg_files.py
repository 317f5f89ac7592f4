"""An ECG in a file that grows, and one of the Lab Streaming Layer."""

import sys
from types import SimpleNamespace

import edfio
import numpy as np
import pytest
from edf_files import write_ecg_edf
from waiting import until

from dvf_ig.core import MissingDependencyError, Signal
from dvf_ig.live.samples.lsl import LslEcg, batches
from dvf_ig.live.samples.respiration import LslBreath
from dvf_ig.live.samples.source import gathered
from dvf_ig.live.samples.tail import EcgTail
from dvf_ig.session import EcgSamples


class Clock:
    """Simulated time."""

    now_s = 10.0

    def __call__(self) -> float:
        return self.now_s


def tell_nothing(sentence: str) -> None:
    raise AssertionError(sentence)


ROWS = "".join(f"0.{i:02d},1,2\n" for i in range(10))


def test_new_lines_of_a_csv_are_samples(tmp_path):
    path, clock = tmp_path / "ecg.csv", Clock()
    tail = EcgTail(path, 100.0, None, tell_nothing, clock)
    assert tail.read() == []
    path.write_text("time_s,I,II\n")
    assert tail.read() == []
    path.write_text(f"time_s,I,II\n{ROWS}0.10,")
    assert tail.read() == []
    with path.open("a") as file:
        file.write("5,6\n0.11,-7e-1,8\n0.12,9")
    (batch,) = tail.read()
    assert batch.start_s == pytest.approx(10.0 - 0.01)
    np.testing.assert_array_equal(batch.samples, [[5, 6], [-0.7, 8]])
    clock.now_s = 10.02
    with path.open("a") as file:
        file.write("9,10\nlead off\n")
    (batch,) = tail.read()
    np.testing.assert_array_equal(batch.samples, [[99, 10], [np.nan, np.nan]])
    path.write_text("time_s,Pleth,V1\n" + ROWS)
    assert tail.read() == []
    with path.open("a") as file:
        file.write("0.11,7,8\n")
    np.testing.assert_array_equal(tail.read()[0].samples, [[8]])


@pytest.mark.parametrize(
    ("head", "row", "lead", "expected"),
    [
        ("t_s,ECG [mV],Pleth,Resp [V]", "{t},1,2,3", None, [[1]]),
        ("Time;EKG;Atmung", "{t};0,5;7", None, [[0.5]]),
        ("t_s,ch1,ch2,V5", "{t},1,2,3", "ch2,V5", [[2, 3]]),
        ("t_s,II [mV],Pleth [mV]", "{t},1,2", "Pleth", [[2]]),
        ("t_s,ch1,ch2", "{t},1,2", None, "2 may be one: ch1, ch2"),
        ("t_s,ABP [mmHg]", "{t},90", None, "no channel of an ECG, only ABP"),
        ("t_s,II", "{t},1", "V9", "has no lead 'V9'; it has II"),
    ],
)
def test_leads_of_a_growing_csv_are_those_of_a_recording(tmp_path, head, row, lead, expected):
    path, told = tmp_path / "ecg.csv", list[str]()
    lines = [row.replace("{t}", f"0.{i:02d}".replace(".", "," if ";" in row else ".")) for i in range(11)]
    path.write_text("\n".join([head, *lines[:10]]) + "\n")
    tail = EcgTail(path, 100.0, lead, told.append, Clock())
    assert tail.read() == []
    with path.open("a") as file:
        file.write(lines[10] + "\n")
    found = [batch.samples.tolist() for batch in tail.read()]
    if isinstance(expected, str):
        assert found == []
        assert expected in told[0]
    else:
        assert (found, told) == ([expected], [])


def test_new_records_of_an_edf_are_samples(tmp_path):
    path, clock = tmp_path / "ecg.edf", Clock()
    samples = np.column_stack([np.arange(400) % 100, 2.0 * (np.arange(400) % 100)])
    write_ecg_edf(Signal(samples, 100.0, 0.0, ("I", "II"), "mV"), path)
    whole = path.read_bytes()
    record = 2 * 2 * 100
    path.write_bytes(whole[: -2 * record])
    tail = EcgTail(path, 100.0, None, tell_nothing, clock)
    assert tail.read() == []
    path.write_bytes(whole[: -record // 2])
    (batch,) = tail.read()
    np.testing.assert_allclose(batch.samples, samples[200:300], atol=1e-6)
    assert batch.start_s == pytest.approx(10.0 - 0.99)
    path.write_bytes(whole)
    np.testing.assert_allclose(tail.read()[0].samples, samples[300:], atol=1e-6)


def test_leads_of_a_growing_edf_may_have_neighbours_of_another_rate(tmp_path):
    path = tmp_path / "ecg.edf"
    ecg, slow = np.arange(400.0) % 100, np.arange(40.0)
    edfio.Edf([edfio.EdfSignal(slow, 10.0, label="Resp"), edfio.EdfSignal(ecg, 100.0, label="EKG")]).write(
        path
    )
    whole = path.read_bytes()
    path.write_bytes(whole[: -2 * 110])
    tail = EcgTail(path, 100.0, None, tell_nothing, Clock())
    assert tail.read() == []
    path.write_bytes(whole)
    np.testing.assert_allclose(tail.read()[0].samples, ecg[300:, None], atol=2e-3)


def test_edf_of_another_rate_is_told(tmp_path):
    path = tmp_path / "ecg.edf"
    told: list[str] = []
    write_ecg_edf(Signal(np.arange(400.0)[:, None], 100.0, 0.0, ("I",), "mV"), path)
    assert EcgTail(path, 250.0, None, told.append, Clock()).read() == []
    assert "live.ecg.rate_hz is 250 Hz" in told[0]


def test_samples_are_gathered_beside_the_session():
    waiting = [[EcgSamples(1.0, np.ones((2, 1)))]]
    reader = SimpleNamespace(read=lambda: waiting.pop() if waiting else [])
    with gathered(reader) as events:
        found = until(events)
    assert isinstance(found[0].event, EcgSamples)
    assert found[0].event.start_s == 1.0
    assert events() == []


def test_gap_in_stamps_begins_a_batch():
    t_s = np.array([1.0, 1.01, 1.02, 1.10, 1.11])
    first, second = batches(t_s, np.arange(5.0)[:, None], 100.0)
    assert (first.start_s, second.start_s) == (1.0, 1.10)
    np.testing.assert_array_equal(second.samples, [[3.0], [4.0]])


def test_stream_that_is_lost_is_looked_for_again(monkeypatch):
    """A stand-in for pylsl: its stamps are 100 s ahead, by a clock whose correction is known."""

    class LostError(Exception):
        pass

    class TooLateError(Exception):
        pass

    class Element:
        """Description of the channel `at`, or of what holds it."""

        def __init__(self, at=0):
            self.at = at

        def child(self, name):
            return self

        def next_sibling(self, name):
            return Element(self.at + 1)

        def child_value(self, name):
            return (("Resp", "volts"), ("ECG II", "millivolts"))[self.at][name == "unit"]

    class Inlet:
        pulls = 0

        def __init__(self, info, recover):
            assert not recover

        def info(self, timeout):
            return SimpleNamespace(desc=Element, type=lambda: "EXG", channel_count=lambda: 2)

        def time_correction(self, timeout):
            return -100.0

        def pull_chunk(self, timeout, max_samples):
            Inlet.pulls += 1
            if Inlet.pulls > 1:
                raise LostError
            return [[1.0, 2.0], [3.0, 4.0]], [105.0, 105.01]

    told: list[str] = []
    clock = Clock()
    library = SimpleNamespace(
        util=SimpleNamespace(LostError=LostError, TimeoutError=TooLateError),
        resolve_byprop=lambda *_: [SimpleNamespace()],
        StreamInlet=Inlet,
        local_clock=lambda: 4.0,
    )
    monkeypatch.setattr("dvf_ig.live.samples.lsl._pylsl", lambda: library)
    ecg = LslEcg("ecg", 100.0, None, told.append, clock)
    assert ecg.read() == []
    (batch,) = ecg.read()
    assert batch.start_s == pytest.approx(5.0 + 10.0 - 4.0)
    np.testing.assert_array_equal(batch.samples, [[2.0], [4.0]])
    assert ecg.read() == []
    assert "lost" in told[0]
    assert LslEcg("ecg", 100.0, "V9", told.append, clock).read() == []
    assert "the LSL stream 'ecg' has no lead 'V9'; it has Resp [volts], ECG II [millivolts]" in told[1]
    Inlet.pulls = 0
    ecg = LslEcg("ecg", 100.0, "Ecg II", told.append, clock)
    assert (ecg.read(), len(ecg.read())) == ([], 1)
    Inlet.pulls = 0
    breath = LslBreath("icu", None, told.append, clock)
    assert breath.read() == []
    first, second = breath.read()
    assert (first.t_s, second.t_s) == pytest.approx((11.0, 11.01))
    np.testing.assert_array_equal([first.values, second.values], [[1.0], [3.0]])


def test_absent_library_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(MissingDependencyError, match=r"needs pylsl and liblsl; .*'\.\[lsl\]'"):
        LslEcg("ecg", 500.0, None, tell_nothing)
