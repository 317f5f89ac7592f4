"""An error carries the key, the file and the settings that it concerns; nobody has to read its text."""

from pathlib import Path

import pytest

from dvf_ig.core import InvalidInputError, Preop, UnreadableFileError
from dvf_ig.intake.parts import SessionFiles
from dvf_ig.intake.preop import PreopFiles
from dvf_ig.intake.problems import ProblemList, concerning
from dvf_ig.io import GatedVolumeFile, read_sequence
from dvf_ig.io.reading import reading


def test_settings_are_spelled_as_the_reader_calls_them() -> None:
    error = InvalidInputError("give its sampling rate", settings=("ecg.rate_hz", "ecg.start_s"))
    assert str(error) == "give its sampling rate (ecg.rate_hz, ecg.start_s)"
    assert error.sentence({"ecg.rate_hz": "--rate"}) == "give its sampling rate (--rate, ecg.start_s)"
    assert error.message == "give its sampling rate"


def test_a_reader_says_which_file(tmp_path: Path) -> None:
    with pytest.raises(UnreadableFileError) as absent:
        read_sequence(tmp_path / "none.igs.mha")
    assert absent.value.path == tmp_path / "none.igs.mha"
    (tmp_path / "there").write_text("")
    with (
        pytest.raises(UnreadableFileError, match="there: wrong") as invalid,
        reading(tmp_path / "there", "x"),
    ):
        raise InvalidInputError("wrong", settings=("ecg.rate_hz",))
    assert (invalid.value.path, invalid.value.settings) == (tmp_path / "there", ("ecg.rate_hz",))


def test_the_innermost_key_is_the_one_that_is_named() -> None:
    problems = ProblemList()
    with problems.about("preop"), concerning("preop.mr", Path("mr.nrrd")):
        raise InvalidInputError("damaged")
    (problem,) = problems.items
    assert (problem.key, problem.error.key, problem.error.path) == ("preop.mr", "preop.mr", Path("mr.nrrd"))
    assert problems.within("preop")
    assert not problems.within("pre")


def test_a_session_without_a_part_names_its_key() -> None:
    volumes = (GatedVolumeFile(Path("ed.nrrd"), phase=0.0),)
    for files, key in ((SessionFiles(), "preop"), (SessionFiles(PreopFiles(Preop("P"), None)), "ultrasound")):
        with pytest.raises(InvalidInputError, match="a registration needs") as missing:
            _ = files.scenario
        assert missing.value.key == key
    with pytest.raises(InvalidInputError) as uncalibrated:
        _ = SessionFiles(volumes=volumes).calibrations
    assert uncalibrated.value.key == "calibration.probe"
