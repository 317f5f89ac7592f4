"""One operating-room recording as a value: what was acquired, and (synthetic only) the ground truth."""

from dataclasses import dataclass

from dvf_ig.core.arrays import FloatArray, frozen_floats, read_only_arrays
from dvf_ig.core.space.image_map import ImageMap
from dvf_ig.core.space.mesh import SurfaceSeries
from dvf_ig.core.space.points import Landmarks, Points
from dvf_ig.core.space.rigid import Rigid
from dvf_ig.core.space.volume import Volume, VolumeSeries
from dvf_ig.core.timing.trigger import TriggerTimes

from .phantom import NWireRecording, TargetRecording
from .sequence import Fan, TrackedSequence
from .signal import Signal, Trace
from .stream import PoseStream

LV_BLOOD = "lv_blood"
"""Name of the label of the left ventricle's blood."""
BLOOD_WORDS = ("blood", "cavity")
"""A label with one of these in its name is blood."""


@dataclass(frozen=True, slots=True, eq=False)
class Preop:
    """The pre-operative data of the heart, in frame "mr".

    The model is built from `labels`, from `mr` with `ed_labels`, or from `surfaces`. Where there is a model
    already, none of them is needed: only whose heart it is.

    Attributes:
        patient_id: whose heart.
        mr: 4-D MR intensities.
        labels: 4-D label image, uint8.
        ed_labels: labels of end-diastole alone, on the grid of `mr`, whose motion carries them.
        ed_phase: the phase of `mr` that `ed_labels` belong to.
        label_names: value to anatomical name; 0 is background.
        organ_labels: the labels whose union the forbidden surface encloses; with `ed_labels`, none means all
            but 0.
        cavity_labels: the labels of blood, that of the left ventricle first; none means those that their
            names tell (see `blood_labels`).
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

    @property
    def blood_labels(self) -> tuple[int, ...]:
        """`cavity_labels`, else the organ's labels whose name has "blood" or "cavity" in it."""
        if self.cavity_labels:
            return self.cavity_labels
        return tuple(
            value
            for value, name in self.label_names
            if (value in self.organ_labels or not self.organ_labels)
            and any(word in name.lower() for word in BLOOD_WORDS)
        )

    @property
    def lv_label(self) -> int | None:
        """The label of the left ventricle's blood, whose volume gives end-systole; None where not known."""
        if self.cavity_labels:
            return self.cavity_labels[0]
        return next((value for value, name in self.label_names if name == LV_BLOOD), None)


@dataclass(frozen=True, slots=True, eq=False)
class LatencyRecording:
    """A water-tank sweep: tracker_from_probe on the tracker clock, wall depth on the video clock."""

    tracker_from_probe: PoseStream
    wall_row_px: Trace


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class ToolTruth:
    """The true contact of the tool tip, sampled on the tracker clock.

    Attributes:
        t_s: (n,).
        tip_mr_mm: (n, 3) tip in frame "mr".
        phi: (n,) true fraction of the RR interval.
        model_phase: (n,) where in the pre-operative cycle the heart truly was, [0, 1).
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
class ScenarioTruth:
    """The ground truth of a synthetic recording. A replay reads it only to score what it has estimated.

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
            each holds: a probe whose marker slipped.
        calibrated_probe_from_image: what the calibration recordings hold, where they are of another probe.
        video_drift_ppm: t_tracker(event) = t_video(event)·(1 + ppm·1e-6) + lag_s.
        respiration_mm: excursion of the heart in breathing; `mr_from_tracker`, `targets` and `surface` are
            those of end-expiration, while `tool` holds the contact as it truly was.
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

    def mr_from_tracker_at(self, t_s: float) -> Rigid:
        """The true pose that holds at `t_s`."""
        held = self.mr_from_tracker[0][1]
        for start_s, pose in self.mr_from_tracker:
            if start_s <= t_s:
                held = pose
        return held

    def probe_from_image_at(self, t_s: float) -> ImageMap:
        """The true image calibration that holds at `t_s`."""
        held = self.probe_from_image
        for start_s, later in self.later_probe_from_image:
            if start_s <= t_s:
                held = later
        return held


@dataclass(frozen=True, slots=True, eq=False)
class Scenario:
    """Every recording of one intervention.

    Clocks: ECG and tracker share one; the video clock differs by the latency to be estimated.

    A calibration is its recording, or its result where it was made before.

    Attributes:
        name: short title.
        preset: which synthetic preset, or "recorded".
        preop: the pre-operative data.
        ecg: ECG of the live part, or the pulses of a trigger in its place.
        ultrasound: images with tracker_from_probe recorded at the video time stamps.
        fan: insonified sector, where the scanner's geometry is known.
        probe: of the image: tracked images of a phantom, or probe_from_image.
        latency: water-tank sweep, or lag_s.
        tool: tracker_from_tool of the live part; None where no tool was tracked.
        tracked_against: what the poses of probe and tool are relative to, by its recorded name: the tracker,
            or a reference marker. Every frame here calls it "tracker".
        tip: tracker_from_tool while pivoting, or the tip in frame "tool"; None where it is not known.
        start: coarse mr_from_tracker given by the operator; it takes precedence over landmarks.
        landmarks_mr, landmarks_tracker: the same anatomical points on the model and touched on the patient.
        touched: points touched all over the heart's surface, in frame "tracker".
        touched_phase: place in the model's cycle at which they were touched; None stands for end-diastole.
        seed: what the synthetic world was drawn from; None for recorded data.
        truth: None for recorded data.
        tool_after_restart: poses of the tool that came after its tracker's clock had restarted, with that
            clock's stamps. Synthetic scenarios are written with them; readers leave them out.
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
