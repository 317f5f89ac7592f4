"""Run as an MCAP log: all inputs of the session, bit for bit, and its output.

For ROS tools: `/tf` (mr, tracker, probe, tool; metres), `/ultrasound/image`, `/ecg`, `/tool/tip`,
`/tool/force` (N, frame "tracker"), `/guidance`, `/diagnostics`. For a replay: `/exact/…` holds stamps in
seconds and poses in mm as they were recorded, since metres, quaternions and nanoseconds round; `session.json`
and `preop/…` are attached and hold the rest. The truth of a synthetic recording is not in a log.
"""

from collections.abc import Iterable, Iterator
from heapq import merge
from operator import itemgetter
from pathlib import Path

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, InvalidInputError, Scenario, TriggerTimes
from dvf_ig.core.arrays import AnyArray
from dvf_ig.intake.calibrations import calibrate
from dvf_ig.intake.session_log.document import (
    DOCUMENT,
    ECG,
    EXACT_FRAME,
    EXACT_TOOL,
    GUIDANCE,
    IMAGE,
    IMAGE_LABEL,
    POSE_LABEL,
    RESPIRATION,
    STATUS_EVERY_S,
    TRIGGER,
    attach_heart,
    document_of,
    exact_pose,
    status_message,
)
from dvf_ig.io.ros import messages as ros
from dvf_ig.io.ros.log_file import written_log
from dvf_ig.replay.events import ECG_CHUNK
from dvf_ig.replay.outputs import TICKS
from dvf_ig.replay.preconditions import tool_of
from dvf_ig.replay.run_folder import RESULT, read_ticks

from .exported_run import ExportedRun

FORCE, TIP = "force_tracker_{}_n", "tip_mr_{}_mm"
Timed = tuple[float, str, str, ros.Message]
"""Time, topic, type, message."""


def write_session_log(
    run: ExportedRun, folder: Path, path: Path, *, given: DvfModel | None = None, seed: int = 0
) -> int:
    """Write the log of a run.

    Args:
        run: a replay, and the folder it is in.
        given: the model, if the run used one from a file.
        seed: seed of the replay: calibrations are computed again with it and compared.
    Returns:
        number of messages in the log.
    Raises:
        InvalidInputError: a registration, which is not a session, or calibrations that are not those of the
            run.
        MissingDependencyError, OutputError: see `written_log`.
    """
    if "estimates" not in run.result:
        raise InvalidInputError(f"{folder} is a registration; only a session has a log: give a replay")
    in_use = calibrate(run.scenario, seed).in_use
    if in_use.probe_from_image.matrix.tolist() != run.result["estimates"]["probe_from_image"]:
        raise InvalidInputError(f"{folder} was replayed with another seed or version; give its --seed")
    count = 0
    with written_log(path) as log:
        preop = attach_heart(log, run.scenario.preop, given)
        document = document_of(run.scenario, in_use.probe_from_image, in_use.lag_s, in_use.tip, preop)
        log.attach(DOCUMENT, "application/json", document)
        log.attach(RESULT, "application/json", (folder / RESULT).read_bytes())
        answers = _answers(read_ticks(folder / TICKS))
        for t_s, topic, kind, message in merge(
            _recorded(run.scenario), _poses(run), answers, key=itemgetter(0)
        ):
            log.write(topic, kind, t_s, message)
            count += 1
    return count


def _recorded(scenario: Scenario) -> Iterator[Timed]:
    yield from merge(
        _beats(scenario), _breaths(scenario), _frames(scenario), _tool(scenario), key=itemgetter(0)
    )


def _beats(scenario: Scenario) -> Iterator[Timed]:
    ecg = scenario.ecg
    if isinstance(ecg, TriggerTimes):
        for t_s in ecg.t_s.tolist():
            yield t_s, TRIGGER, ros.ARRAY, ros.array(np.array([t_s]), ("t_s of a pulse",))
        return
    label = f"leads {', '.join(ecg.leads)} ({ecg.unit})"
    for first in range(0, len(ecg), ECG_CHUNK):
        message = ros.array(ecg.samples[first : first + ECG_CHUNK], ("samples", label))
        yield ecg.start_s + first / ecg.rate_hz, ECG, ros.ARRAY, message


def _breaths(scenario: Scenario) -> Iterator[Timed]:
    recorded = scenario.respiration
    if recorded is None:
        return
    for t_s, values in zip(recorded.t_s.tolist(), recorded.values, strict=True):
        row = ros.array(np.array([t_s, *values]), (f"t_s, then {recorded.name}",))
        yield t_s, RESPIRATION, ros.ARRAY, row


def _frames(scenario: Scenario) -> Iterator[Timed]:
    sequence = scenario.ultrasound
    stream = sequence.stream("tracker", "probe")
    label = POSE_LABEL.format("probe") + IMAGE_LABEL
    for i, t_s in enumerate(sequence.t_s.tolist()):
        exact = exact_pose(t_s, stream.valid[i], stream.rotations[i], stream.translations_mm[i])
        values = np.append(exact, float(sequence.image_valid[i]))
        yield t_s, EXACT_FRAME, ros.ARRAY, ros.array(values, (label,))
        if sequence.images is not None:
            yield t_s, IMAGE, ros.IMAGE, ros.image(t_s, "image", sequence.images[i])
        if stream.valid[i]:
            yield t_s, "/tf", ros.TF, ros.transforms(t_s, [("tracker", "probe", stream.pose(i).matrix)])


def _tool(scenario: Scenario) -> Iterator[Timed]:
    stream = tool_of(scenario)
    label = POSE_LABEL.format("tool")
    for i, t_s in enumerate(stream.t_s.tolist()):
        exact = exact_pose(t_s, stream.valid[i], stream.rotations[i], stream.translations_mm[i])
        yield t_s, EXACT_TOOL, ros.ARRAY, ros.array(exact, (label,))
        if stream.valid[i]:
            yield t_s, "/tf", ros.TF, ros.transforms(t_s, [("tracker", "tool", stream.pose(i).matrix)])


def _poses(run: ExportedRun) -> Iterator[Timed]:
    """Yield mr_from_tracker as it changed; for ROS the tracker's parent is the MR."""
    for from_s, pose in run.poses:
        yield from_s, "/tf", ros.TF, ros.transforms(from_s, [("mr", "tracker", pose.matrix)])


def _answers(ticks: dict[str, AnyArray]) -> Iterator[Timed]:
    """Yield the session's output every millisecond; `ticks` are columns by name, as from `read_ticks`."""
    last: tuple[float, ...] = ()
    due_s = -np.inf
    forces, tips = (_rows(ticks, (form.format(a) for a in "xyz")) for form in (FORCE, TIP))
    numbers, codes = _rows(ticks, GUIDANCE), _rows(ticks, ("status", "supervisor", "hazards"))
    for i, t_s in enumerate(ticks["t_s"].tolist()):
        yield t_s, "/tool/force", ros.WRENCH, ros.wrench(t_s, "tracker", forces[i])
        yield t_s, "/guidance", ros.ARRAY, ros.array(numbers[i], (", ".join(GUIDANCE),))
        if np.isfinite(tips[i]).all():
            yield t_s, "/tool/tip", ros.POSE, ros.pose(t_s, "mr", tips[i])
        now = tuple(codes[i].tolist())
        if now != last or t_s >= due_s:
            last, due_s = now, t_s + STATUS_EVERY_S
            yield t_s, "/diagnostics", ros.DIAGNOSTICS, status_message(t_s, *(int(code) for code in now))


def _rows(ticks: dict[str, AnyArray], names: Iterable[str]) -> FloatArray:
    """(n, k) of k columns."""
    return np.column_stack([ticks[name] for name in names])
