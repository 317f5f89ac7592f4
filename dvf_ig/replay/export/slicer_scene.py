"""Run or registration as a 3D Slicer scene folder: the recording, placed in the patient.

    scene (RAS, the pre-operative images)
    ├─ mr, labels, heart_…, heart_now_…, targets, landmarks_mr
    └─ TrackerToRas          the registration; a sequence if there were updates
       ├─ ProbeToTracker     at the moment that each image shows
       │  └─ ImageToProbe    calibration, pixels to mm
       │     └─ ultrasound
       ├─ ToolToTracker
       │  └─ tool_tip
       └─ landmarks_touched

If poses are relative to a reference marker, its name replaces "Tracker". Device coordinates are kept, as
Slicer does with PLUS sequences: a node's matrix is ours, and RAS enters once, in TrackerToRas =
diag(−1, −1, 1)·mr_from_tracker.
"""

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from dvf_ig.core import (
    DvfModel,
    FloatArray,
    IntArray,
    InvalidInputError,
    Landmarks,
    Mesh,
    Points,
    Tissue,
    Volume,
    Warp,
    read_only_arrays,
)
from dvf_ig.core.space.frames import RAS_FROM_LPS
from dvf_ig.guidance.tissue import TissueClass, class_of
from dvf_ig.io import write_mesh, write_text, write_volume
from dvf_ig.io.plus.names import join_transform, split_transform
from dvf_ig.io.plus.sequence_write import write_transform_sequence
from dvf_ig.io.slicer.mrml import SlicerScene
from dvf_ig.io.slicer.nodes import (
    Segment,
    pixel_grid,
    write_node_points,
    write_node_transform,
    write_segmentation,
    write_volume_sequence,
)
from dvf_ig.kernels.warp import LARGEST_SIGMA_MM
from dvf_ig.report.registration.shape import shape_shown
from dvf_ig.report.style import label_color
from dvf_ig.session.gated_frames import smoothed_poses

from .exported_run import ExportedRun
from .slicer_readme import readme_text

SCENE, README = "scene.mrml", "README.md"
HEART_COLOR, UNSEEN_COLOR = (0.84, 0.37, 0.0), (0.55, 0.56, 0.6)
MOVED_MM = 1.0
"""Shift along its normal from which a part of the patient's surface is shown as moved."""
SHIFT_PARTS = (
    ("further_in", (0.13, 0.4, 0.67), f"more than {MOVED_MM:g} mm further in than in the images"),
    ("in_place", (0.95, 0.95, 0.95), f"within {MOVED_MM:g} mm of its place in the images"),
    ("further_out", (0.7, 0.09, 0.17), f"more than {MOVED_MM:g} mm further out than in the images"),
    ("not_known", UNSEEN_COLOR, "not known well enough for a force"),
)
IMAGE = "ImageToProbe"


@dataclass(slots=True)
class SceneFolder:
    """Folder that is being written, its scene, and the frame of each file's content."""

    folder: Path
    run: ExportedRun
    scene: SlicerScene = field(default_factory=SlicerScene)
    frames: dict[str, str] = field(default_factory=dict)

    def place(self, name: str, frame: str) -> Path:
        """Return the path of a file and record its frame."""
        self.frames[name] = frame
        return self.folder / name


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ShownFrames:
    """Ultrasound frames of a scene: those with an image, a pose of the probe and one of the patient.

    Attributes:
        number: (n,) in the recording; event_s: time at which the shown event happened, tracker's clock.
        probe, tool: (n, 4, 4) tracker_from_probe and tracker_from_tool then; `tool` is None without a tool,
            and its last pose while not tracked.
        pose: (n,) index of the pose of the run.
    """

    number: IntArray
    event_s: FloatArray
    probe: FloatArray
    tool: FloatArray | None
    pose: IntArray


def write_slicer_scene(run: ExportedRun, model: DvfModel, folder: Path) -> dict[str, str]:
    """Write `scene.mrml`, the files it loads, and a README on how to load each file alone.

    Args:
        folder: exists and is empty.
    Returns:
        the frame of each file's content, by file name.
    Raises:
        InvalidInputError: no ultrasound frame has an image and a pose.
        OutputError: not writable.
    """
    out = SceneFolder(folder, run)
    frames = shown_frames(run)
    _patient(out, model)
    browsed = _tracked(out, frames)
    out.scene.add_browser("recording", browsed, rate_hz=_rate_hz(frames.event_s))
    out.scene.write(out.place(SCENE, "scene"))
    write_text(
        out.place(README, "text"),
        readme_text(out.frames, run, len(frames.number), tuple(model.timing.fractions.tolist())),
    )
    return out.frames


def shown_frames(run: ExportedRun) -> ShownFrames:
    """Select the `ShownFrames`; frames of one millisecond count once, as Slicer identifies them by it.

    Raises:
        InvalidInputError: there are none.
    """
    sequence = run.scenario.ultrasound
    event_s = sequence.t_s + run.ultrasound.lag_s
    rotations, translations, valid = smoothed_poses(sequence.stream("tracker", "probe"), event_s)
    shown = valid & sequence.image_valid & ~run.suspended(event_s)
    chosen = np.flatnonzero(shown)
    if sequence.images is None or not len(chosen):
        raise InvalidInputError(
            "no ultrasound frame has an image and a tracked pose; there is nothing to show"
        )
    chosen = chosen[np.unique(np.round(event_s[chosen], 3), return_index=True)[1]]
    tool = run.scenario.tool
    at = event_s[chosen]
    tool_poses = None
    if tool is not None and run.tip is not None and tool.valid.any():
        tracked = np.flatnonzero(tool.valid)
        last = tracked[np.maximum(np.searchsorted(tool.t_s[tracked], at, side="right") - 1, 0)]
        tool_poses = _matrices(tool.rotations[last], tool.translations_mm[last])
    probe = _matrices(rotations[chosen], translations[chosen])
    return ShownFrames(chosen.astype(np.int64), at, probe, tool_poses, run.pose_numbers(at))


def _patient(out: SceneFolder, model: DvfModel) -> None:
    """Add the content of the pre-operative frame: images, surfaces, targets."""
    preop, scenario = out.run.scenario.preop, out.run.scenario
    if preop.mr is not None:
        name = "mr.mha"
        shown = Volume(preop.mr.grid, preop.mr.values[preop.ed_phase])
        write_volume(shown, out.place(name, "mr"))
        mr = out.scene.add_volume("mr", name, description=f"phase {preop.ed_phase}")
        sequence, index = "mr.seq.nrrd", preop.mr.timing.fractions.tolist()
        write_volume_sequence(
            out.place(sequence, "mr"), preop.mr.values, index, grid=preop.mr.grid, name="phase", unit="RR"
        )
        of_cycle = out.scene.add_sequence("mr cycle", sequence, index="phase", unit="RR")
        out.scene.add_browser("heart cycle", [(of_cycle, mr)], rate_hz=len(index) / preop.mr.timing.rr_s)
    if model.tissue is not None:
        name = "labels.seg.nrrd"
        shown = _labels_now(model.tissue, model, out.run.warp)
        write_segmentation(out.place(name, "mr"), shown, [_segment(*one) for one in model.tissue.names])
        out.scene.add_segmentation(
            "labels", name, description="tissue at end-diastole, as the patient has it"
        )
    for phase, (mesh, fraction) in enumerate(zip(model.reference, model.timing.fractions, strict=True)):
        unseen = model.unseen(phase)
        parts = [("heart", ~unseen, HEART_COLOR, "")]
        if unseen.any():
            parts.append(
                ("heart_unseen", unseen, UNSEEN_COLOR, ", no MR slice shows this part: closed, no force")
            )
        for start, part, color, note in parts:
            name = f"{start}_{phase:03d}.stl"
            write_mesh(Mesh(mesh.frame, mesh.vertices_mm, mesh.triangles[part]), out.place(name, model.frame))
            description = f"{model.surface_name} at {fraction:.3f} of the RR interval{note}"
            visible = phase == model.ed_phase
            out.scene.add_model(name[:-4], name, visible=visible, color=color, description=description)
    if out.run.warp is not None:
        _patient_surface(out, model, out.run.warp)
    truth = scenario.truth
    if truth is not None:
        _points(out, "targets", truth.targets)
    if scenario.landmarks_mr is not None:
        _points(out, "landmarks_mr", scenario.landmarks_mr)


def _labels_now(tissue: Tissue, model: DvfModel, warp: Warp | None) -> Volume:
    """Look labels of end-diastole up through the change of the heart's shape since the MR."""
    labels = tissue.labels
    if warp is None:
        return labels
    places = labels.grid.centers_mm().reshape(-1, 3)
    ed = float(model.timing.fractions[model.ed_phase])
    values = tissue.label_at(warp.model_places(places), ed, model.timing)
    return Volume(labels.grid, values.astype(np.uint8).reshape(labels.grid.shape))


def _segment(value: int, name: str) -> Segment:
    """Describe a label: its colour as in the viewer, and the properties of its tissue with their sources."""
    rgb = label_color(value)
    red, green, blue = (int(rgb[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    kind = class_of(name)
    tags = () if kind is None else (("Tissue", kind.name), *_tagged(kind))
    return Segment(value, name.replace("_", " "), (red, green, blue), tags)


def _tagged(kind: TissueClass) -> tuple[tuple[str, str], ...]:
    """Tag each property; a tag holds neither : nor |."""
    return tuple(
        (what, f"{value} ({source.replace(':', ',').replace('|', '/')})")
        for what, value, source in kind.properties
    )


def _patient_surface(out: SceneFolder, model: DvfModel, warp: Warp) -> None:
    """Add the surface as the patient has it at end-diastole, in parts by how far it has moved."""
    shown = shape_shown("", model.reference[model.ed_phase], warp, LARGEST_SIGMA_MM)
    outward = shown.outward_mm[shown.triangles].mean(axis=1)
    certain = shown.known[shown.triangles].all(axis=1)
    step = np.where(certain, np.digitize(outward, [-MOVED_MM, MOVED_MM]), len(SHIFT_PARTS) - 1)
    for number, (part, color, note) in enumerate(SHIFT_PARTS):
        triangles = shown.triangles[step == number]
        if len(triangles):
            name = f"heart_now_{part}.stl"
            write_mesh(Mesh(model.frame, shown.now_mm, triangles), out.place(name, model.frame))
            description = f"the patient's {model.surface_name} at end-diastole, {note}"
            out.scene.add_model(name[:-4], name, visible=True, color=color, description=description)


def _points(out: SceneFolder, name: str, landmarks: Landmarks, parent: str | None = None) -> None:
    bound = out.run.bound_mm
    description = "no bound on the registration error was stated"
    if bound is not None:
        description = f"registration error below {bound:.1f} mm with 95 % probability"
    file = f"{name}.mrk.json"
    path = out.place(file, landmarks.frame)
    write_node_points(
        landmarks, path, tracked=parent is not None, descriptions=[description] * len(landmarks.names)
    )
    out.scene.add_points(name, file, parent, description=description)


def _tracked(out: SceneFolder, frames: ShownFrames) -> list[tuple[str, str]]:
    """Add the tracker's children; return sequences, each with its node, the images first."""
    run, scene = out.run, out.scene
    by_number = np.array([RAS_FROM_LPS @ pose.matrix for _, pose in run.poses])
    tracker = run.scenario.tracked_against  # its name in the lab's own sequences
    name = join_transform("ras", tracker)
    placed, of_pose = _moving(out, name, by_number[frames.pose], frames.event_s, None)
    probe, of_probe = _moving(out, join_transform(tracker, "probe"), frames.probe, frames.event_s, placed)
    write_node_transform(
        run.ultrasound.probe_from_image.matrix, out.place(f"{IMAGE}.tfm", "probe_from_image")
    )
    calibrated = scene.add_transform(
        IMAGE, f"{IMAGE}.tfm", probe, description="image calibration, mm per pixel"
    )
    images = run.scenario.ultrasound.images
    if images is None:
        raise InvalidInputError("the recording has no images")
    values = np.swapaxes(images[frames.number], 1, 2)[..., None]
    first, sequence = "ultrasound.mha", "ultrasound.seq.nrrd"
    grid = pixel_grid(*values.shape[1:3])
    write_volume(Volume(grid, values[0]), out.place(first, "image"))
    write_volume_sequence(
        out.place(sequence, "image"), values, frames.event_s.tolist(), grid=grid, name="time", unit="s"
    )
    shown = scene.add_volume(
        "ultrasound", first, calibrated, description="first frame; the browser plays all"
    )
    browsed = [(scene.add_sequence("ultrasound frames", sequence, index="time", unit="s"), shown)]
    browsed += [of_probe, of_pose]
    if frames.tool is not None and run.tip is not None:
        tool, of_tool = _moving(out, join_transform(tracker, "tool"), frames.tool, frames.event_s, placed)
        browsed.append(of_tool)
        tip = Landmarks(("tool tip",), Points("tool", run.tip.xyz_mm))
        write_node_points(tip, out.place("tool_tip.mrk.json", "tool"), tracked=True)
        scene.add_points("tool_tip", "tool_tip.mrk.json", tool)
    touched = run.scenario.landmarks_tracker
    if touched is not None:
        _points(out, "landmarks_touched", touched, placed)
    return browsed


def _moving(
    out: SceneFolder, name: str, matrices: FloatArray, t_s: FloatArray, parent: str | None
) -> tuple[str, tuple[str, str]]:
    """Add a transform over time: the id of its node, and the pair for the browser."""
    first, sequence = f"{name}.tfm", f"{name}.seq.mha"
    frame = "_from_".join(split_transform(name) or (name,))
    write_node_transform(matrices[0], out.place(first, frame))
    comment = (
        f"{name}, mm, row-major 4x4, to parent, in coordinates as the device reports them; Timestamp in s"
    )
    write_transform_sequence(name, t_s.tolist(), matrices, out.place(sequence, frame), comment)
    shown = out.scene.add_transform(name, first, parent)
    return shown, (out.scene.add_sequence(f"{name} over time", sequence, index="time", unit="s"), shown)


def _matrices(rotations: FloatArray, translations_mm: FloatArray) -> FloatArray:
    """(n, 4, 4)"""
    out = np.tile(np.eye(4), (len(rotations), 1, 1))
    out[:, :3, :3], out[:, :3, 3] = rotations, translations_mm
    return out


def _rate_hz(t_s: FloatArray) -> float:
    return float(1.0 / np.median(np.diff(t_s))) if len(t_s) > 1 else 1.0
