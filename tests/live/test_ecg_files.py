"""An ECG in a file that grows, and one of the Lab Streaming Layer."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest
from edf_files import write_ecg_edf
from waiting import until

from dvf_ig.core import MissingDependencyError, Signal
from dvf_ig.live.ecg.lsl import LslEcg, batches
from dvf_ig.live.ecg.source import gathered
from dvf_ig.live.ecg.tail import CsvTail, EdfTail
from dvf_ig.session import EcgSamples


class Clock:
    """Simulated time."""

    now_s = 10.0

    def __call__(self) -> float:
        return self.now_s


def tell_nothing(sentence: str) -> None:
    raise AssertionError(sentence)


def test_new_lines_of_a_csv_are_samples(tmp_path):
    path, clock = tmp_path / "ecg.csv", Clock()
    tail = CsvTail(path, 100.0, tell_nothing, clock)
    assert tail.read() == []
    path.write_text("time_s,I,II\n0.00,1,2\n0.01,3,4\n")
    assert tail.read() == []
    with path.open("a") as file:
        file.write("0.02,5,6\n0.03,-7e-1,8\n0.04,9")
    (batch,) = tail.read()
    assert batch.start_s == pytest.approx(10.0 - 0.01)
    np.testing.assert_array_equal(batch.samples, [[5, 6], [-0.7, 8]])
    clock.now_s = 10.02
    with path.open("a") as file:
        file.write("9,10\nlead off\n")
    (batch,) = tail.read()
    np.testing.assert_array_equal(batch.samples, [[99, 10], [np.nan, np.nan]])
    path.write_text("1,2\n")
    assert len(tail.read()) == 1


def test_new_records_of_an_edf_are_samples(tmp_path):
    path, clock = tmp_path / "ecg.edf", Clock()
    samples = np.column_stack([np.arange(400) % 100, 2.0 * (np.arange(400) % 100)])
    write_ecg_edf(Signal(samples, 100.0, 0.0, ("I", "II"), "mV"), path)
    whole = path.read_bytes()
    record = 2 * 2 * 100
    path.write_bytes(whole[: -2 * record])
    tail = EdfTail(path, 100.0, tell_nothing, clock)
    assert tail.read() == []
    path.write_bytes(whole[: -record // 2])
    (batch,) = tail.read()
    np.testing.assert_allclose(batch.samples, samples[200:300], atol=1e-6)
    assert batch.start_s == pytest.approx(10.0 - 0.99)
    path.write_bytes(whole)
    np.testing.assert_allclose(tail.read()[0].samples, samples[300:], atol=1e-6)


def test_edf_of_another_rate_is_told(tmp_path):
    path = tmp_path / "ecg.edf"
    told: list[str] = []
    write_ecg_edf(Signal(np.arange(400.0)[:, None], 100.0, 0.0, ("I",), "mV"), path)
    assert EdfTail(path, 250.0, told.append, Clock()).read() == []
    assert "250 Hz" in told[0]


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


def test_stream_that_is_lost_is_looked_for_again():
    """A stand-in for pylsl: its stamps are 100 s ahead, by a clock whose correction is known."""

    class LostError(Exception):
        pass

    class TooLateError(Exception):
        pass

    class Inlet:
        pulls = 0

        def __init__(self, info, recover):
            assert not recover

        def time_correction(self, timeout):
            return -100.0

        def pull_chunk(self, timeout, max_samples):
            Inlet.pulls += 1
            if Inlet.pulls > 1:
                raise LostError
            return [[1.0, 2.0], [3.0, 4.0]], [105.0, 105.01]

    told: list[str] = []
    clock = Clock()
    ecg = object.__new__(LslEcg)
    library = SimpleNamespace(
        util=SimpleNamespace(LostError=LostError, TimeoutError=TooLateError),
        resolve_byprop=lambda *_: [SimpleNamespace(channel_count=lambda: 2)],
        StreamInlet=Inlet,
        local_clock=lambda: 4.0,
    )
    ecg._lsl, ecg._name, ecg._rate_hz, ecg._channels = library, "ecg", 100.0, [1]
    ecg._tell, ecg._clock, ecg._inlet, ecg._corrected_s = told.append, clock, None, float("-inf")
    assert ecg.read() == []
    (batch,) = ecg.read()
    assert batch.start_s == pytest.approx(5.0 + 10.0 - 4.0)
    np.testing.assert_array_equal(batch.samples, [[2.0], [4.0]])
    assert ecg.read() == []
    assert "lost" in told[0]
    assert ecg.read() == []
    assert ecg._inlet is not None


def test_absent_library_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pylsl", None)
    with pytest.raises(MissingDependencyError, match=r"dvf-ig\[lsl\]"):
        LslEcg("ecg", 500.0, (), tell_nothing)
