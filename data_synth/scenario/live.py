"""Live part of a scenario: tracked ultrasound and tool, with the tool's true contact."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from data_synth.breathing.motion import seen_at_rest
from data_synth.heart.tissue import Tissue
from data_synth.operator.contact import tool_truth
from data_synth.operator.contact_sites import contact_sites
from data_synth.operator.hand import perpendicular
from data_synth.operator.pose_path import composed, inverted
from data_synth.operator.tool_path import tip_path, tool_path
from data_synth.seeds import child_seed
from data_synth.signals.occlusion import losses_in_contact
from data_synth.signals.tracker import PosePath, TrackerSpec, sampling_times, tracked
from data_synth.signals.tracker_failure import TrackerFailureSpec, split_at_restart, with_frozen_poses
from data_synth.ultrasound.image_failure import with_failure
from data_synth.ultrasound.image_faults import degraded
from data_synth.ultrasound.sequence import simulate_sequence
from data_synth.ultrasound.tool_echo import with_tool
from dvf_ig.core import BoolArray, FloatArray, Points, PoseStream, Rigid, ToolTruth, TrackedSequence

from .world import ANTERIOR_LEFT, World

TICK_HZ = 1000.0
LINE_OVERHEAD = 1.1
SOUND_MM_S = 1.54e6
_ALONG_RAY = np.linspace(0.1, 1.0, 19)
_HIDING = (int(Tissue.LUNG), int(Tissue.BONE))

Report = Callable[[float], None]


@dataclass(frozen=True, slots=True, eq=False)
class ToolTask:
    """Path of the tool, mr_from_tool, and the true contact of its tip at every millisecond.

    Attributes:
        tip: one point in frame "tool"; the shaft reaches from there to the frame's origin.
    """

    mr_from_tool: PosePath
    contact: ToolTruth
    tip: Points

    def tip_mm(self, t_s: FloatArray) -> FloatArray:
        """Compute (n, 3) positions of the tip, frame "mr"."""
        rotations, places = self.mr_from_tool(t_s)
        return np.asarray(rotations @ self.tip.xyz_mm[0] + places)


def tool_task(world: World) -> ToolTask:
    """Draw the operator's task on the beating, breathing heart; the hand follows the breathing."""
    spec, breathing, tip_in_tool = world.spec, world.breathing, world.truth.tip_in_tool
    rng = world.rng("tool path")
    access = perpendicular(world.window, ANTERIOR_LEFT)
    options = world.options.tool
    sites = contact_sites(world.surface, access, options.sites, rng)
    tip = tip_path(world.surface, world.clock, sites, spec.seconds, options, rng)
    heart_from_tool = tool_path(tip, access, world.truth.tip_in_tool, rng)
    ticks_s = np.arange(round(spec.seconds * TICK_HZ)) / TICK_HZ
    met = tool_truth(world.surface, world.clock, ticks_s, tip(ticks_s))
    if breathing is None:
        return ToolTask(heart_from_tool, met, tip_in_tool)
    path = breathing.carried(heart_from_tool, tip_in_tool.xyz_mm[0])
    return ToolTask(path, breathing.carried_contact(met), tip_in_tool)


def tracked_tool(world: World, task: ToolTask) -> tuple[PoseStream, PoseStream | None]:
    """Simulate tracker_from_tool as measured, and the poses after a restart of its clock, if any."""
    rng, options, seconds = world.rng("tool tracker"), world.options, world.spec.seconds
    spec = _with_losses(options.tool_tracker, options.tool_failure, world, task.contact, "tool sight")
    true_s, stamp_s = sampling_times(spec, 0.0, seconds, rng)
    path = composed(inverted(world.patient), task.mr_from_tool)
    stream = tracked(path, "tracker", "tool", true_s, stamp_s, spec, rng)
    reported = with_frozen_poses(stream, options.tool_failure, seconds)
    return split_at_restart(reported, options.tool_clock, seconds)


def tracked_ultrasound(
    world: World, mr_from_plane: PosePath, task: ToolTask, report: Report
) -> TrackedSequence:
    """Simulate images stamped on the video clock, each with tracker_from_probe as tracked at its stamp.

    An image taken at tracker time t carries the stamp (t − lag)/(1 + drift), and the recorder looks up the
    tracker at that number: the pose of an image is the one from about `lag` earlier, as from an uncorrected
    recorder.
    """
    spec, options, rng = world.spec, world.options, world.rng("ultrasound")
    stamp_s, taken_s = _image_times(world, rng)
    rest_from_plane, anatomies = seen_at_rest(world.breathing, mr_from_plane, world.anatomy, taken_s)
    poses = [Rigid("mr", "plane", r, t) for r, t in zip(*rest_from_plane(taken_s), strict=True)]
    images = simulate_sequence(
        anatomies,
        world.probe,
        poses,
        _line_phases(world, taken_s),
        seed=child_seed(spec.seeds.speckle, "speckle"),
        progress=lambda done, count: report(done / count),
    )
    images = _with_tool(images, world, mr_from_plane, task, taken_s)
    images = degraded(images, world.probe, taken_s, options.image, world.rng("image faults"))
    images = with_failure(
        images, world.probe, taken_s, options.image_failure, spec.seconds, world.rng("image failure")
    )
    tracker = _with_losses(options.probe_tracker, options.probe_failure, world, task.contact, "probe sight")
    tracker_from_probe = composed(composed(inverted(world.patient), mr_from_plane), inverted(world.mount))
    stream = tracked(
        tracker_from_probe, "tracker", "probe", stamp_s - tracker.latency_s, stamp_s, tracker,
        world.rng("probe tracker"),
    )  # fmt: skip
    stream = with_frozen_poses(stream, options.probe_failure, spec.seconds)
    return TrackedSequence(stamp_s, images, np.ones(len(stamp_s), dtype=np.bool_), {stream.name: stream})


def _with_tool(
    images: NDArray[np.uint8], world: World, mr_from_plane: PosePath, task: ToolTask, taken_s: FloatArray
) -> NDArray[np.uint8]:
    """Add the tool's echo to the images if the preset shows it."""
    spec = world.options.tool_echo
    if not spec.shown:
        return images
    rotations, places = composed(inverted(mr_from_plane), task.mr_from_tool)(taken_s)
    tip = task.tip.xyz_mm[0]
    shaft = rotations @ (-tip / np.linalg.norm(tip))
    rest_from_plane, anatomies = seen_at_rest(world.breathing, mr_from_plane, world.anatomy, taken_s)
    turns, apex = rest_from_plane(taken_s)
    phases = world.clock.model_phase(taken_s)

    def hidden(i: int, points: FloatArray) -> BoolArray:
        rays = points[:, None] * _ALONG_RAY[:, None]
        met = anatomies[i].tissue((rays @ turns[i].T + apex[i]).reshape(-1, 3), float(phases[i]))
        return np.asarray(np.isin(met.reshape(rays.shape[:2]), _HIDING).any(axis=1))

    return with_tool(
        images, world.probe, rotations @ tip + places, shaft, hidden, spec, world.rng("tool echo")
    )


def _image_times(world: World, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Draw (n,) stamps on the video clock, and (n,) true times of the images."""
    spec, lag_s = world.spec, world.truth.lag_s
    step_s = 1.0 / spec.us_rate_hz
    taken_s = np.arange(0.1, spec.seconds - 0.1, step_s)
    jitter = world.options.video_jitter_s * rng.standard_normal(len(taken_s))
    taken_s = taken_s + np.clip(jitter, -0.1 * step_s, 0.1 * step_s)
    pace = 1.0 + 1e-6 * world.options.video_drift_ppm
    stamp_s = np.round((taken_s - lag_s) / pace, 6)
    return stamp_s, stamp_s * pace + lag_s


def _line_phases(world: World, taken_s: FloatArray) -> FloatArray:
    """Compute the (n, lines) model phase at which each line of each image was acquired."""
    line_s = LINE_OVERHEAD * 2.0 * world.probe.depth_mm / SOUND_MM_S
    offsets_s = (np.arange(world.probe.lines) - 0.5 * (world.probe.lines - 1)) * line_s
    return world.clock.model_phase(taken_s[:, None] + offsets_s)


def _with_losses(
    spec: TrackerSpec, failure: TrackerFailureSpec, world: World, contact: ToolTruth, stream: str
) -> TrackerSpec:
    losses = losses_in_contact(contact, world.options.occlusion, world.rng(stream))
    return replace(spec, lost_s=spec.lost_s + losses + failure.lost_s(world.spec.seconds))
