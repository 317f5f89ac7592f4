"""A run as a recording of the Rerun viewer (`.rrd`): the scene in space, and its numbers over time.

Entities are nested as frames are: `mr` (LPS, mm) / `tracker` / `probe`, `tool`. Time is in seconds on
the tracker's clock. The surfaces through the cycle are on a time line of their own, `phase`.
"""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from dvf_ig.core import DvfModel, FloatArray, MissingDependencyError, OutputError, Signal
from dvf_ig.core.arrays import AnyArray
from dvf_ig.core.errors import install_extra
from dvf_ig.guidance import Hazard, SupervisorState
from dvf_ig.io.writing.atomic import atomic_file
from dvf_ig.replay.outputs import breath_word
from dvf_ig.replay.preconditions import RATE_HZ

from .exported_run import ExportedRun
from .slicer_scene import ShownFrames, shown_frames

FORCE_MM_PER_N = 50.0
"""Length of the force's arrow."""
FORCE_HZ = 100.0
"""Rate at which the arrow is drawn; its numbers are complete."""
NUMBERS = ("distance_mm", "phi", "model_phase", "rr_s", "pose_age_s", "breath_phase", "breath_mm")
"""Columns of ticks.csv that become curves."""


def write_rerun(run: ExportedRun, model: DvfModel, ticks: dict[str, AnyArray], path: Path) -> int:
    """Write the recording.

    Args:
        ticks: columns of ticks.csv by name.
    Returns:
        number of ultrasound frames shown.
    Raises:
        MissingDependencyError: rerun-sdk is absent.
        InvalidInputError: no ultrasound frame has an image and a pose.
        OutputError: not writable.
    """
    rerun = _package()
    frames = shown_frames(run)
    with atomic_file(path) as temporary, _wrapped(path):
        stream = rerun.RecordingStream("dvf_ig", recording_id=run.scenario.name or "run")
        stream.save(str(temporary))
        stream.log("mr", rerun.ViewCoordinates.LBU, static=True)
        _surfaces(rerun, stream, model)
        _poses(rerun, stream, run, frames)
        _ultrasound(rerun, stream, run, frames)
        _tool(rerun, stream, ticks)
        _numbers(rerun, stream, run, ticks)
        stream.flush()
        stream.disconnect()
    return len(frames.number)


@contextmanager
def _wrapped(path: Path) -> Iterator[None]:
    """Convert the package's error of writing to an OutputError."""
    try:
        yield
    except RuntimeError as exc:
        raise OutputError(f"cannot write {path}: {str(exc).splitlines()[-1]}") from exc


def _package() -> Any:
    try:
        import rerun
    except ImportError as exc:
        raise MissingDependencyError(
            f"a recording of Rerun needs the package rerun-sdk; {install_extra('rerun')}"
        ) from exc
    return rerun


def _surfaces(rerun: Any, stream: Any, model: DvfModel) -> None:
    """Log end-diastole at all times, and every phase on the time line of phases."""

    def mesh(phase: int) -> Any:
        surface = model.reference[phase]
        return rerun.Mesh3D(
            vertex_positions=surface.vertices_mm.astype(np.float32),
            triangle_indices=surface.triangles.astype(np.uint32),
            albedo_factor=[214, 94, 0, 90],
        )

    stream.log("mr/heart_end_diastole", mesh(model.ed_phase), static=True)
    for phase, fraction in enumerate(model.timing.fractions.tolist()):
        stream.set_time("phase", duration=fraction)
        stream.log("mr/heart", mesh(phase))
    stream.reset_time()


def _poses(rerun: Any, stream: Any, run: ExportedRun, frames: ShownFrames) -> None:
    """Log the tracker in the MR and the probe in the tracker's frame."""
    for number, (from_s, pose) in enumerate(run.poses):
        begin_s = min(from_s, float(frames.event_s[0])) if number == 0 else from_s
        stream.set_time("time", duration=begin_s)
        stream.log("mr/tracker", _transform(rerun, pose.matrix))
    for t_s, matrix in zip(frames.event_s.tolist(), frames.probe, strict=True):
        stream.set_time("time", duration=t_s)
        stream.log("mr/tracker/probe", _transform(rerun, matrix))
    stream.reset_time()


def _ultrasound(rerun: Any, stream: Any, run: ExportedRun, frames: ShownFrames) -> None:
    """Log the outline of the image in space, and the image itself."""
    images = run.scenario.ultrasound.images
    if images is None:
        return
    rows, columns = images.shape[1:]
    corners = np.array([[0, 0], [columns, 0], [columns, rows], [0, rows], [0, 0]], dtype=np.float64) - 0.5
    outline = run.ultrasound.probe_from_image.apply_pixels(corners).xyz_mm
    stream.log("mr/tracker/probe/image", rerun.LineStrips3D([outline.astype(np.float32)]), static=True)
    for t_s, number in zip(frames.event_s.tolist(), frames.number.tolist(), strict=True):
        stream.set_time("time", duration=t_s)
        stream.log("ultrasound", rerun.Image(images[number]))
    stream.reset_time()


def _tool(rerun: Any, stream: Any, ticks: dict[str, AnyArray]) -> None:
    """Log the tip and the force at it, in the tracker's frame."""
    tip, force = (_rows(ticks, form) for form in ("tip_tracker_{}_mm", "force_tracker_{}_n"))
    step = max(1, round(RATE_HZ / FORCE_HZ))
    tracked = np.flatnonzero(np.isfinite(tip).all(axis=1))
    for i in tracked[::step].tolist():
        stream.set_time("time", duration=float(ticks["t_s"][i]))
        stream.log("mr/tracker/tip", rerun.Points3D([tip[i]], radii=[1.5]))
        arrow = rerun.Arrows3D(origins=[tip[i]], vectors=[FORCE_MM_PER_N * force[i]])
        stream.log("mr/tracker/force", arrow)
    stream.reset_time()


def _numbers(rerun: Any, stream: Any, run: ExportedRun, ticks: dict[str, AnyArray]) -> None:
    """Log curves over time, and as messages the supervisor's states and those of the clock of breathing."""
    t_s, wave = ticks["t_s"], run.scenario.ecg
    force = np.linalg.norm(_rows(ticks, "force_tracker_{}_n"), axis=1)
    curves = [("force_n", t_s, force), *((name, t_s, ticks[name]) for name in NUMBERS)]
    if isinstance(wave, Signal):
        curves.append(("ecg", wave.t_s, wave.samples[:, 0]))
    for name, at, values in curves:
        finite = np.isfinite(values)
        if finite.any():
            index = [rerun.TimeColumn("time", duration=at[finite])]
            stream.send_columns(f"numbers/{name}", index, rerun.Scalars.columns(scalars=values[finite]))
    for entity, names, sentence in (
        ("supervisor", ("supervisor", "hazards"), _sentence),
        ("breathing", ("breath_state",), lambda state: breath_word(state) or "not followed"),
    ):
        said = np.column_stack([ticks[name] for name in names])
        changed = np.flatnonzero(np.any(np.diff(said, axis=0, prepend=-1.0), axis=1))
        for i in changed.tolist():
            stream.set_time("time", duration=float(t_s[i]))
            stream.log(entity, rerun.TextLog(sentence(*said[i].astype(int).tolist())))
    stream.reset_time()


def _sentence(supervisor: int, hazards: int) -> str:
    active = ", ".join(one.name.lower() for one in Hazard(hazards) if one.name)
    return f"{SupervisorState(supervisor).name.lower()}{': ' if active else ''}{active}"


def _transform(rerun: Any, matrix: FloatArray) -> Any:
    """Build the transform from the entity's points to its parent's, mm."""
    return rerun.Transform3D(translation=matrix[:3, 3], mat3x3=matrix[:3, :3])


def _rows(ticks: dict[str, AnyArray], form: str) -> FloatArray:
    return np.column_stack([ticks[form.format(axis)] for axis in "xyz"])
