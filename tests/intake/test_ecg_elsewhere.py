"""A scenario's ECG, taken out by hand and put into other files, is the same to the last bit."""

from pathlib import Path

import numpy as np
import pytest
from edf_files import write_ecg_edf

from dvf_ig.core import Scenario, Signal, UnreadableFileError
from dvf_ig.intake.readers import read_channel
from dvf_ig.intake.schema import EcgConfig
from dvf_ig.io import add_ecg_field, read_ecg, read_sequence


def require_same(found: Signal, scenario: Scenario) -> None:
    assert isinstance(scenario.ecg, Signal)
    np.testing.assert_array_equal(found.samples, scenario.ecg.samples)
    assert (found.rate_hz, found.start_s) == (scenario.ecg.rate_hz, scenario.ecg.start_s)


def test_inside_its_ultrasound(scenario: Scenario, written: Path, tmp_path: Path) -> None:
    assert isinstance(scenario.ecg, Signal)
    path = tmp_path / "sweep.igs.mha"
    add_ecg_field(written / "ultrasound.igs.mha", scenario.ecg, path)
    require_same(read_ecg(str(path)), scenario)
    found, before = read_sequence(path), scenario.ultrasound
    assert found.images is not None
    assert before.images is not None
    np.testing.assert_array_equal(found.images, before.images)
    np.testing.assert_array_equal(found.t_s, before.t_s)


def test_as_edf(scenario: Scenario, tmp_path: Path) -> None:
    assert isinstance(scenario.ecg, Signal)
    assert write_ecg_edf(scenario.ecg, tmp_path / "ecg.edf") == pytest.approx(0.0)
    require_same(read_ecg(f"edf:{tmp_path / 'ecg.edf'}"), scenario)


def test_the_lead_that_a_session_names(scenario: Scenario, tmp_path: Path) -> None:
    assert isinstance(scenario.ecg, Signal)
    pairs = zip(scenario.ecg.t_s.tolist(), scenario.ecg.samples[:, 0].tolist(), strict=True)
    rows = (f"{t!r},{v!r},{-v!r}" for t, v in pairs)
    (tmp_path / "ecg.csv").write_text("\n".join(["t_s,A,B", *rows]))
    config = EcgConfig(file="csv:ecg.csv")
    with pytest.raises(UnreadableFileError, match=r"2 may be one: A, B; name the lead .ecg\.lead.") as raised:
        read_channel(config, tmp_path, "ecg.file")
    assert raised.value.key == "ecg.file"
    read = read_channel(config.model_copy(update={"lead": "B"}), tmp_path, "ecg.file")
    assert isinstance(read, Signal)
    assert (read.leads, read.left_out) == (("B",), ("A",))
