"""One operating-room recording as a value: the acquired data, and (synthetic only) the ground truth."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core.arrays import FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.mesh import SurfaceSeries
from dvf_ig.core.space.points import Landmarks, Points
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.core.space.volume import Volume, VolumeSeries
from dvf_ig.core.timing.trigger import TriggerTimes

from .phantom import NWireRecording, TargetRecording
from .sequence import Fan, TrackedSequence
from .signal import Respiration, Signal, Trace
from .stream import PoseStream

LV_BLOOD = "lv_blood"
"""Name of the label of the left ventricle's blood."""
BLOOD_WORDS = ("blood", "cavity")
"""Words in the name of a label that mark it as blood."""


@dataclass(frozen=True, slots=True, eq=False)
class Preop:
    """Pre-operative data of the heart, in frame "mr".

    The model is built from `labels`, from `mr` with `ed_labels`, or from `surfaces`. If there is a model
    already, none of them is needed, only the patient's identifier.

    Attributes:
        patient_id: identifier of the patient.
        mr: 4-D MR intensities.
        views: long-axis cines of the examination whose short-axis stack `mr` is, one slice each.
        labels: 4-D label image, uint8.
        ed_labels: labels of end-diastole alone, on the grid of `mr`, whose motion carries them.
        ed_phase: phase of `mr` that `ed_labels` belong to.
        label_names: value to anatomical name; 0 is background.
        organ_labels: the labels whose union the forbidden surface encloses; with `ed_labels`, none means all
            except 0.
        cavity_labels: the labels of blood, that of the left ventricle first; none means those found by name
            (see `blood_labels`).
        surfaces: corresponding surface series, each with its name.
        surface: name of the surface that fixtures are built on (for surfaces), e.g. "EPICARDIAL".
    """

    patient_id: str
    mr: VolumeSeries | None = None
    labels: VolumeSeries | None = None
    ed_labels: Volume | None = None
    ed_phase: int = 0
    label_names: tuple[tuple[int, str], ...] = ()
    organ_labels: tuple[int, ...] = ()
    surfaces: tuple[SurfaceSeries, ...] = ()
    surface: str = "EPICARDIAL"
    cavity_labels: tuple[int, ...] = ()
    views: tuple[VolumeSeries, ...] = ()

    @property
    def blood_labels(self) -> tuple[int, ...]:
        """Labels of blood: `cavity_labels`, else organ labels with "blood" or "cavity" in their name.

        The left ventricle's comes first, if it is known.
        """
        if self.cavity_labels:
            return self.cavity_labels
        named = [
            value
            for value, name in self.label_names
            if (value in self.organ_labels or not self.organ_labels)
            and any(word in name.lower() for word in BLOOD_WORDS)
        ]
        return tuple(sorted(named, key=lambda value: value != self.lv_label))

    @property
    def lv_label(self) -> int | None:
        """Label of the left ventricle's blood, whose volume gives end-systole; None if not known."""
        if self.cavity_labels:
            return self.cavity_labels[0]
        return next((value for value, name in self.label_names if name == LV_BLOOD), None)


@dataclass(frozen=True, slots=True, eq=False)
class LatencyRecording:
    """Water-tank sweep: tracker_from_probe on the tracker clock, wall depth on the video clock."""

    tracker_from_probe: PoseStream
    wall_row_px: Trace


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ToolTruth:
    """True contact of the tool tip, sampled on the tracker clock.

    Attributes:
        t_s: (n,).
        tip_mr_mm: (n, 3) tip in frame "mr".
        phi: (n,) true fraction of the RR interval.
        model_phase: (n,) true position of the heart in the pre-operative cycle, [0, 1).
        distance_mm: (n,) signed distance to the true surface, positive inside.
        normal: (n, 3) unit gradient of that distance (points into the organ).
    """

    t_s: FloatArray
    tip_mr_mm: FloatArray
    phi: FloatArray
    model_phase: FloatArray
    distance_mm: FloatArray
    normal: FloatArray

    def __post_init__(self) -> None:
        t_s = frozen_floats(self.t_s, "truth times", (None,))
        object.__setattr__(self, "t_s", t_s)
        for name, shape in (
            ("tip_mr_mm", (len(t_s), 3)),
            ("phi", (len(t_s),)),
            ("model_phase", (len(t_s),)),
            ("distance_mm", (len(t_s),)),
            ("normal", (len(t_s), 3)),
        ):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), f"truth {name}", shape))


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BreathingTruth:
    """True motion of the heart in breathing, from its rest at end-expiration.

    Attributes:
        t_s: (n,) increasing, tracker clock.
        mr_from_rest: (n, 3, 4) pose of the heart in frame "mr".
        targets_mm: (n, k, 3) positions in frame "mr" of the targets, change of shape included.
    """

    t_s: FloatArray
    mr_from_rest: FloatArray
    targets_mm: FloatArray

    def __post_init__(self) -> None:
        t_s = frozen_floats(self.t_s, "times of breathing", (None,))
        object.__setattr__(self, "t_s", t_s)
        for name, shape in (("mr_from_rest", (len(t_s), 3, 4)), ("targets_mm", (len(t_s), None, 3))):
            object.__setattr__(self, name, frozen_floats(getattr(self, name), f"truth {name}", shape))

    def targets_at(self, t_s: FloatArray) -> FloatArray:
        """Interpolate (m, k, 3) positions of the targets at (m,) times."""
        after = np.clip(np.searchsorted(self.t_s, t_s), 1, len(self.t_s) - 1)
        low, high = self.t_s[after - 1], self.t_s[after]
        weight = np.clip((t_s - low) / (high - low), 0.0, 1.0)[:, None, None]
        return (1.0 - weight) * self.targets_mm[after - 1] + weight * self.targets_mm[after]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ScenarioTruth:
    """Ground truth of a synthetic recording, which a replay reads only to score its estimates.

    Attributes:
        mr_from_tracker: true poses with the times (tracker clock) from which each holds.
        probe_from_image: true image calibration.
        tip: tool tip in frame "tool", one point.
        lag_s: t_tracker(event) = t_video(event) + lag_s.
        r_peaks_s: (k,) true R peaks on the tracker clock.
        targets: named points in frame "mr" at which the registration error is declared.
        surface: the true moving surface in frame "mr" (of the anatomy the tool meets).
        tool: true contact of the tool.
        mismatch_mm: RMS of the non-rigid difference between pre-operative and intra-operative anatomy.
        later_probe_from_image: image calibrations after the first, with the times (tracker clock) from which
            each holds: as if the probe's marker slipped.
        calibrated_probe_from_image: image calibration of the calibration recordings if they are of another
            probe.
        video_drift_ppm: t_tracker(event) = t_video(event)·(1 + ppm·1e-6) + lag_s.
        respiration_mm: excursion of the heart in breathing; `mr_from_tracker`, `targets` and `surface` hold
            at end-expiration, while `tool` holds the actual contact.
        breathing: that motion; None without.
    """

    mr_from_tracker: tuple[tuple[float, Rigid], ...]
    probe_from_image: ImageMap
    tip: Points
    lag_s: float
    r_peaks_s: FloatArray
    targets: Landmarks
    surface: SurfaceSeries
    tool: ToolTruth
    mismatch_mm: float
    later_probe_from_image: tuple[tuple[float, ImageMap], ...] = ()
    calibrated_probe_from_image: ImageMap | None = None
    video_drift_ppm: float = 0.0
    respiration_mm: float = 0.0
    breathing: BreathingTruth | None = None

    def mr_from_tracker_at(self, t_s: float) -> Rigid:
        """Return the true pose at `t_s`."""
        current = self.mr_from_tracker[0][1]
        for start_s, pose in self.mr_from_tracker:
            if start_s <= t_s:
                current = pose
        return current

    def probe_from_image_at(self, t_s: float) -> ImageMap:
        """Return the true image calibration at `t_s`."""
        current = self.probe_from_image
        for start_s, later in self.later_probe_from_image:
            if start_s <= t_s:
                current = later
        return current


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """All recordings of one intervention.

    Clocks: ECG and tracker share one; the video clock differs by the latency to be estimated.

    A calibration is its recording, or its result if it was made before.

    Attributes:
        name: short title.
        preset: name of the synthetic preset, or "recorded".
        preop: the pre-operative data.
        ecg: ECG of the live part, or the pulses of a trigger instead.
        ultrasound: images with tracker_from_probe recorded at the video time stamps.
        fan: insonified sector, if the scanner's geometry is known.
        probe: image calibration: tracked images of a phantom, or probe_from_image.
        latency: water-tank sweep, or lag_s.
        tool: tracker_from_tool of the live part; None if no tool was tracked.
        tracked_against: recorded name of the reference of the poses of probe and tool: the tracker,
            or a reference marker. Every frame here calls it "tracker".
        tip: tracker_from_tool while pivoting, or the tip in frame "tool"; None if not known.
        start: coarse mr_from_tracker given by the operator; it takes precedence over landmarks.
        landmarks_mr, landmarks_tracker: the same anatomical points on the model and touched on the patient.
        touched: points touched all over the heart's surface, in frame "tracker".
        touched_phase: model phase at which they were touched; None means end-diastole.
        seed: seed of the synthetic world; None for recorded data.
        truth: None for recorded data.
        tool_after_restart: poses of the tool after its tracker's clock restarted, with the new clock's
            stamps. Synthetic scenarios are written with them; readers leave them out.
        respiration: what follows the breath, if it was recorded.
        ventilator, chest: all channels of a ventilator, and tracker_from_chest of a marker; `respiration` is
            one of them. Synthetic scenarios are written with them; readers leave them out.
    """

    name: str
    preset: str
    preop: Preop
    ecg: Signal | TriggerTimes
    ultrasound: TrackedSequence
    fan: Fan | None
    probe: NWireRecording | TargetRecording | ImageMap
    latency: LatencyRecording | float
    tool: PoseStream | None = None
    tracked_against: str = "tracker"
    tip: PoseStream | Points | None = None
    start: Rigid | None = None
    landmarks_mr: Landmarks | None = None
    landmarks_tracker: Landmarks | None = None
    touched: Points | None = None
    touched_phase: float | None = None
    seed: int | None = None
    truth: ScenarioTruth | None = None
    tool_after_restart: PoseStream | None = None
    respiration: Respiration | None = None
    ventilator: Signal | None = None
    chest: PoseStream | None = None
