"""Read every file of a session, whatever is wrong with some of them, and say what is."""

from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

from dvf_ig.core.errors import UnreadableFileError
from dvf_ig.intake.calibration import read_latency_source, read_probe_source, read_tip_source
from dvf_ig.intake.named_files import is_there, named_files
from dvf_ig.intake.parts import SessionParts, StartFiles, read_session_ecg, read_start, read_sweep, read_tool
from dvf_ig.intake.preop import read_preop
from dvf_ig.intake.problem import Problem, ProblemList
from dvf_ig.intake.read import read_session_fixtures
from dvf_ig.intake.schema import SessionDraft
from dvf_ig.io.plus.names import ProbeNames
from dvf_ig.io.truth import read_truth

T = TypeVar("T")


def examine(config: SessionDraft, folder: Path, named_by: str) -> tuple[SessionParts, tuple[Problem, ...]]:
    """The parts of a session that can be read, and why others cannot.

    Args:
        folder: where names of files begin.
        named_by: what names them, for messages.
    """
    reader = _Reader(config, folder)
    parts = reader.parts()
    reader.part("fixtures", lambda: read_session_fixtures(config, folder, named_by))
    if config.truth is not None:
        truth = folder / config.truth
        reader.part("truth", lambda: read_truth(truth))
    return parts, tuple(reader.problems.found)


class _Reader:
    """Reads one part after the other; a part of which a file is absent is left out."""

    def __init__(self, config: SessionDraft, folder: Path) -> None:
        files = [(key, folder / name) for key, name in named_files(config)]
        self.config, self.folder, self.problems = config, folder, ProblemList(files)
        for key, path in files:
            if not is_there(path, key):
                with self.problems.about(key):
                    raise UnreadableFileError(f"{path} does not exist; copy it there, or mend its name")

    def part(self, section: str, read: Callable[[], T]) -> T | None:
        """What `read` gives; None where it fails, or something was wrong with the section before."""
        if not any(problem.key.startswith(section) for problem in self.problems.found):
            with self.problems.about(section):
                return read()
        return None

    def parts(self) -> SessionParts:
        """Every part, read once."""
        config, folder, part = self.config, self.folder, self.part
        us, heart, calibration = config.ultrasound, config.preop, config.calibration
        fan, probe, latency, tip = us.fan, calibration.probe, calibration.latency, calibration.tip
        names = part("ultrasound", lambda: ProbeNames.from_plus(us.probe_name, us.reference_name))
        known = names or ProbeNames()
        path = folder / us.file
        sweep = part("ultrasound", lambda: read_sweep(path, known))
        tool = part("tool", lambda: read_tool(config.tool, folder, sweep))
        recorded = "tool" if tool is None else tool.source
        no_ecg = config.ecg is None and sweep is None
        patient = config.patient_id
        return SessionParts(
            preop=None if heart is None else part("preop", lambda: read_preop(heart, folder, patient)),
            sweep=sweep,
            fan=None if fan is None else part("ultrasound.fan", fan.fan),
            ecg=None if no_ecg else part("ecg", lambda: read_session_ecg(config.ecg, folder, path)),
            tool=tool,
            probe=None
            if probe is None
            else part("calibration.probe", lambda: read_probe_source(probe, folder, known)),
            latency=None
            if latency is None
            else part("calibration.latency", lambda: read_latency_source(latency, folder, known)),
            tip=None
            if tip is None
            else part("calibration.tip", lambda: read_tip_source(tip, folder, recorded)),
            start=part("start", lambda: read_start(config.start, folder)) or StartFiles(),
        )
