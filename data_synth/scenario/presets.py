"""Named presets of synthetic interventions: rhythm, disturbances and errors."""

from dataclasses import dataclass, field, replace
from typing import get_args

from data_synth.breathing.breaths import BreathSpec
from data_synth.heart.heart_spec import STANDARD_HEART, HeartSeeds, HeartSpec
from data_synth.heart.mismatch import UNTOUCHED, SurgicalChange
from data_synth.heart.motion import MotionChange, MotionPreset
from data_synth.mr.examination import EXAMS, ExamName
from data_synth.operator.probe_path import SweepSpec
from data_synth.operator.tool_in_view import LookSpec
from data_synth.operator.tool_path import ToolSpec
from data_synth.phantoms.nwire import NWireSpec
from data_synth.phantoms.watertank import WaterTankSpec
from data_synth.signals.ecg import EcgSpec
from data_synth.signals.occlusion import OcclusionSpec
from data_synth.signals.rhythm import RhythmSpec
from data_synth.signals.tracker import TrackerSpec
from data_synth.signals.tracker_failure import ClockRestartSpec, TrackerFailureSpec
from data_synth.ultrasound.image_failure import ImageFailureSpec
from data_synth.ultrasound.image_faults import ImageSpec
from data_synth.ultrasound.image_probe import CalibratedImage
from data_synth.ultrasound.tool_echo import ToolEchoSpec
from dvf_ig.core import InvalidInputError

from .displacement import Displacement

MOTIONS: tuple[MotionPreset, ...] = get_args(MotionPreset)


@dataclass(frozen=True, slots=True)
class Preset:
    """Values that a preset fixes; the defaults are those of "calm".

    Attributes:
        rhythm, ecg, sweep, tool, image, nwire, watertank: see their classes.
        probe_tracker, tool_tracker: errors of the two sensors in the live part.
        pivot_tracker, nwire_tracker, watertank_tracker: sensor errors in these calibration recordings.
        occlusion: long losses of the probe's and the tool's markers while the tool is in contact.
        probe_failure, tool_failure: one failure of each sensor in the live part.
        tool_clock: the clock of the tool's tracker restarts in the live part.
        image_failure: images stop showing the heart.
        tool_echo: how images show the tool.
        looks: the operator turns the image to the tool now and then.
        patient_shift: mr_from_tracker changes; the displacement is that of the heart's centre.
        probe_slip: probe_from_image changes; the displacement is that of the image's middle.
        other_probe_mm, other_probe_deg: distance of the image of the probe in the calibration recordings
            from that of the probe used live (exact at its middle; directions are random).
        mismatch_mm: RMS non-rigid difference between pre-operative and intra-operative anatomy.
        surgery: change of the heart's shape by surgery, in addition to that.
        contraction: factors on the contraction in the MR, of hearts with even and with odd seeds.
        still_mm: radius of a region of the free wall that stands still; 0: none (see `MotionChange`).
        video_jitter_s: SD of the instants at which images are taken, about the regular grid.
        video_drift_ppm: drift by which the video clock is slower than the tracker's.
        start_mm, start_deg: error of the coarse start.
        touched: number of points touched over the front of the heart, at end-diastole.
        respiration: breathing; none by default, as with high-frequency ventilation.
    """

    rhythm: RhythmSpec = field(default_factory=RhythmSpec)
    ecg: EcgSpec = field(default_factory=EcgSpec)
    sweep: SweepSpec = field(default_factory=SweepSpec)
    tool: ToolSpec = field(default_factory=ToolSpec)
    image: ImageSpec = field(default_factory=ImageSpec)
    nwire: NWireSpec = field(default_factory=NWireSpec)
    watertank: WaterTankSpec = field(default_factory=WaterTankSpec)
    probe_tracker: TrackerSpec = field(
        default_factory=lambda: TrackerSpec(rate_hz=12.0, dropouts_per_min=1.0)
    )
    tool_tracker: TrackerSpec = field(
        default_factory=lambda: TrackerSpec(
            rate_hz=100.0, position_mm=0.1, rotation_deg=0.05, dropouts_per_min=2.0
        )
    )
    nwire_tracker: TrackerSpec = field(
        default_factory=lambda: TrackerSpec(rate_hz=12.0, dropouts_per_min=1.0)
    )
    pivot_tracker: TrackerSpec = field(
        default_factory=lambda: TrackerSpec(rate_hz=20.0, position_mm=0.1, rotation_deg=0.05)
    )
    watertank_tracker: TrackerSpec = field(default_factory=lambda: TrackerSpec(rate_hz=50.0))
    occlusion: OcclusionSpec = field(default_factory=OcclusionSpec)
    probe_failure: TrackerFailureSpec = field(default_factory=TrackerFailureSpec)
    tool_failure: TrackerFailureSpec = field(default_factory=TrackerFailureSpec)
    tool_clock: ClockRestartSpec = field(default_factory=ClockRestartSpec)
    image_failure: ImageFailureSpec = field(default_factory=ImageFailureSpec)
    tool_echo: ToolEchoSpec = field(default_factory=ToolEchoSpec)
    looks: LookSpec = field(default_factory=LookSpec)
    patient_shift: Displacement = field(default_factory=Displacement)
    probe_slip: Displacement = field(default_factory=Displacement)
    other_probe_mm: float = 0.0
    other_probe_deg: float = 0.0
    mismatch_mm: float = 1.2
    surgery: SurgicalChange = UNTOUCHED
    contraction: tuple[float, float] = (1.0, 1.0)
    still_mm: float = 0.0
    video_jitter_s: float = 0.001
    video_drift_ppm: float = 0.0
    start_mm: float = 10.0
    start_deg: float = 8.0
    touched: int = 0
    respiration: BreathSpec = field(default_factory=BreathSpec)

    def __post_init__(self) -> None:
        if not 0.0 <= self.mismatch_mm <= 8.0:
            raise InvalidInputError(f"mismatch is {self.mismatch_mm:g} mm; needed 0 to 8 mm")
        if not 0.0 <= self.other_probe_mm <= 100.0 or not 0.0 <= self.other_probe_deg <= 90.0:
            raise InvalidInputError(
                f"the calibrated probe is {self.other_probe_mm:g} mm and {self.other_probe_deg:g}° from the "
                "one used; needed 0 to 100 mm and 0 to 90°"
            )
        for factor in self.contraction:
            MotionChange(factor, self.still_mm)
        if abs(self.video_drift_ppm) > 5000.0:
            raise InvalidInputError(
                f"the video clock drifts {self.video_drift_ppm:g} ppm; needed ±5000 at most"
            )
        if min(self.start_mm, self.start_deg, self.video_jitter_s) < 0:
            raise InvalidInputError("the coarse start's offset or the video's jitter is negative")


DEFORMED = Preset(mismatch_mm=5.0, surgery=SurgicalChange(retraction_mm=8.0, load_mm=2.5))

PRESETS: dict[str, Preset] = {
    "calm": Preset(),
    "tachycardia": Preset(rhythm=RhythmSpec(rate_bpm=((8.0, 60.0), (52.0, 120.0)))),
    "ectopy": Preset(rhythm=RhythmSpec(ectopic_share=0.1)),
    "line-of-sight-loss": Preset(occlusion=OcclusionSpec(losses_per_min=4.0)),
    "probe-slip": Preset(probe_slip=Displacement(shift_mm=6.0, turn_deg=4.0)),
    "patient-shift": Preset(patient_shift=Displacement(shift_mm=8.0, turn_deg=3.0, over_s=0.5)),
    "poor-image": Preset(
        image=ImageSpec(clutter=5.0, shadows=3, dynamic_range_db=45.0),
        probe_tracker=TrackerSpec(rate_hz=12.0, position_mm=1.0, rotation_deg=0.7, dropouts_per_min=1.0),
        mismatch_mm=2.0,
    ),
    "wrong-calibration": Preset(other_probe_mm=6.0, other_probe_deg=4.0),
    "lost-ultrasound": Preset(
        probe_failure=TrackerFailureSpec(lost=True),
        image_failure=ImageFailureSpec(shows="noise"),
        patient_shift=Displacement(shift_mm=8.0, shift_up_to_mm=15.0, over_s=0.5, wait_s=(2.0, 10.0)),
    ),
    "noise-ultrasound": Preset(image_failure=ImageFailureSpec(shows="noise")),
    "black-ultrasound": Preset(image_failure=ImageFailureSpec(shows="black")),
    "frozen-ultrasound": Preset(image_failure=ImageFailureSpec(shows="frozen")),
    "frozen-tool": Preset(tool_failure=TrackerFailureSpec(frozen_s=20.0)),
    "tool-clock-restart": Preset(tool_clock=ClockRestartSpec(back_s=10.0)),
    "late-ecg": Preset(ecg=EcgSpec(latency_s=0.3)),
    "tool-in-view": Preset(tool_echo=ToolEchoSpec(shown=True), looks=LookSpec(for_s=3.0)),
    "tool-elsewhere": Preset(
        tool_echo=ToolEchoSpec(shown=True),
        looks=LookSpec(for_s=3.0),
        other_probe_mm=6.0,
        other_probe_deg=4.0,
    ),
    "tool-unseen": Preset(looks=LookSpec(for_s=3.0)),
    "deformed": DEFORMED,
    "deformed-touched": replace(DEFORMED, touched=60),
    "other-motion": Preset(contraction=(0.6, 1.3)),
    "still-wall": Preset(still_mm=50.0),
    "ventilated": Preset(respiration=BreathSpec("ventilated", excursion_mm=10.0)),
    "breathing": Preset(
        respiration=BreathSpec(
            "spontaneous", excursion_mm=6.0, tilt_deg=1.5, stretch_mm=0.35, nonrigid_mm=0.2
        )
    ),
    "unrecorded-breathing": Preset(respiration=BreathSpec("ventilated", excursion_mm=10.0, recorded=False)),
    "atrial": Preset(tool=ToolSpec(sites=1, slide_mm=30.0, contact_s=12.0)),
}
"""calm: about 72 beats/min with mild variability, low noise, short drop-outs. Every other one is calm except:
tachycardia: the rate climbs from 60 to 120 beats/min between 8 and 52 s.
ectopy: one beat in ten is a ventricular extrasystole with a full compensatory pause.
line-of-sight-loss: both markers are lost for 1.5 to 4 s, four times a minute, while the tool touches.
probe-slip: half-way the marker slips on the probe: the image's middle is 6 mm and 4° from where it was.
patient-shift: half-way the patient moves within 0.5 s: the heart's centre by 8 mm, and by 3° about it.
poor-image: clutter ×5, shadows, 45 dB of dynamic range, 2 mm mismatch, 1 mm and 0.7° of noise on the probe.
wrong-calibration: N-wire and water-tank recordings are of a probe whose image lies 6 mm and 4° off.
lost-ultrasound: half-way the probe is laid aside for good: no pose is OK, images show noise; 2 to 10 s later
    the patient moves by 8 to 15 mm within 0.5 s.
noise-ultrasound: from half-way on images show weak noise; the probe stays tracked.
black-ultrasound: from half-way on images are black; the probe stays tracked.
frozen-ultrasound: from half-way on one image is repeated; stamps and poses go on.
frozen-tool: half-way the tool's pose freezes, bit for bit and with status OK, for 20 s.
tool-clock-restart: half-way the clock of the tool's tracker restarts 10 s back.
late-ecg: the ECG is stamped 0.3 s late from the beginning.
tool-in-view: images show the tool, and the operator turns them to it for 3 s every 8 s.
tool-elsewhere: the same with the calibrations of wrong-calibration.
tool-unseen: the same looks, at a tool that images do not show.
deformed: a retractor presses the free wall in by 8 mm, the heart is fuller (2.5 mm), and its shape differs by
    5 mm RMS from that in the MR.
deformed-touched: the same, with 60 points touched over the front of the heart before.
other-motion: the heart contracts 0.6 (even seeds) or 1.3 times (odd) as far as in the MR.
still-wall: a region half-way up the left ventricle's free wall, moving in the MR, stands still; 23 mm from
    its middle it moves by half.
ventilated: a ventilator moves the heart by 10 mm, 14 times a minute; its channels and a marker on the chest
    are recorded.
breathing: the patient breathes, 6 mm, 14 times a minute and unevenly; a chest marker is recorded.
unrecorded-breathing: ventilated, and nothing records the breath.
atrial: the tool slides along one line of 30 mm, again and again; `dvf-ig synth scenario` adds the fixtures.
"""


def preset_name(name: str) -> str:
    """Find the key of PRESETS for a name, ignoring capitals, spaces and underscores.

    Raises:
        InvalidInputError: there is no such preset.
    """
    key = "-".join(name.lower().replace("_", " ").replace("-", " ").split())
    if key not in PRESETS:
        raise InvalidInputError(f"there is no preset '{name}'; choose from {', '.join(PRESETS)}")
    return key


@dataclass(frozen=True, slots=True)
class ScenarioSpec:
    """Specification of a synthetic scenario; the same values give bit-identical recordings.

    Attributes:
        preset: a key of PRESETS, spelt with hyphens or spaces.
        motion: motion of the phantom's heart: "paper5mm" or "physiological".
        seconds: length of the live part.
        seed: seed of every random choice, a non-negative integer.
        us_rate_hz: ultrasound frame rate.
        mismatch_mm: overrides the preset's mismatch.
        changed: replacement of the preset if it was adapted; None takes it unchanged.
        image: a real probe's calibration and image size; None draws one for the standard probe.
        heart: kind of heart, and seeds that differ from `seed`; each draws what `seed` of that number draws.
            For a scenario on real anatomy only those of mismatch and speckle count.
        exam: the phantom's MR as a hospital's examination (see `mr.examination`); None: isotropic 4-D MR with
            labels of every phase.
    """

    preset: str = "calm"
    motion: MotionPreset = "paper5mm"
    seconds: float = 60.0
    seed: int = 1
    us_rate_hz: float = 12.0
    mismatch_mm: float | None = None
    changed: Preset | None = None
    image: CalibratedImage | None = None
    heart: HeartSpec = STANDARD_HEART
    exam: ExamName | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "preset", preset_name(self.preset))
        if self.motion not in MOTIONS:
            raise InvalidInputError(f"there is no motion '{self.motion}'; choose from {', '.join(MOTIONS)}")
        if self.exam is not None and self.exam not in EXAMS:
            raise InvalidInputError(f"there is no examination '{self.exam}'; choose from {', '.join(EXAMS)}")
        if not 5.0 <= self.seconds <= 3600.0:
            raise InvalidInputError(f"the scenario is to last {self.seconds:g} s; needed 5 to 3600 s")
        if not 6.0 <= self.us_rate_hz <= 60.0:
            raise InvalidInputError(
                f"ultrasound rate is {self.us_rate_hz:g} Hz; needed 6 to 60 Hz (poses are recorded with the "
                "images, and slower ones cannot be interpolated)"
            )
        if self.seed < 0:
            raise InvalidInputError(f"the seed is {self.seed}; needed a non-negative integer")
        if self.mismatch_mm is not None and not 0.0 <= self.mismatch_mm <= 8.0:
            raise InvalidInputError(f"mismatch is {self.mismatch_mm:g} mm; needed 0 to 8 mm")

    @property
    def options(self) -> Preset:
        return PRESETS[self.preset] if self.changed is None else self.changed

    @property
    def mismatch(self) -> float:
        """Mismatch in use, mm."""
        return self.options.mismatch_mm if self.mismatch_mm is None else self.mismatch_mm

    @property
    def motion_change(self) -> MotionChange:
        """Change of the heart's motion since the MR."""
        return MotionChange(self.options.contraction[self.seed % 2], self.options.still_mm)

    @property
    def seeds(self) -> HeartSeeds:
        """Seeds in use of anatomy, motion, mismatch and speckle."""
        return self.heart.seeds(self.seed)


def describe_faults(preset: Preset) -> tuple[str, ...]:
    """Describe each disturbance beyond ordinary noise in a sentence without its size or time."""
    ecg, image, rates = preset.ecg, preset.image, [rate for _, rate in preset.rhythm.rate_bpm]
    trackers = (preset.probe_tracker, preset.tool_tracker)
    disturbances = (
        (max(rates) - min(rates) > 10, "The heart rate changes a lot."),
        (preset.rhythm.ectopic_share > 0, "Some beats are ventricular extrasystoles."),
        (preset.tool.sites == 1, "The tool slides along one line of the heart."),
        (bool(ecg.lead_off_s), "ECG electrodes come off for a while."),
        (bool(ecg.noise_bursts_s), "Bursts of noise cover the ECG."),
        (bool(ecg.missed_beats), "Some beats leave no trace in the ECG."),
        (preset.respiration.moves, "The heart moves with respiration."),
        (bool(preset.respiration.events), "Breathing does not stay the same."),
        (
            preset.occlusion.losses_per_min > 0 or any(t.lost_s for t in trackers),
            "The tracker loses sight of probe and tool for seconds.",
        ),
        (any(t.latency_s > 0 for t in trackers), "The tracker reports its poses late."),
        (preset.video_drift_ppm != 0, "The video clock drifts against the tracker's."),
        (preset.patient_shift.happens, "The patient moves against the tracker's base."),
        (preset.probe_slip.happens, "The marker slips on the ultrasound probe."),
        (
            preset.other_probe_mm > 0 or preset.other_probe_deg > 0,
            "The probe's calibration recordings are of another probe.",
        ),
        (preset.looks.for_s > 0, "The operator turns the image to the tool now and then."),
        (preset.tool_echo.shown, "The ultrasound images show the tool."),
        (image.clutter > 0, "Clutter covers the ultrasound images."),
        (image.shadows > 0, "Parts of the ultrasound images lie in shadow."),
        (image.dynamic_range_db < 50, "The ultrasound images have little dynamic range."),
        (preset.probe_tracker.position_mm > 0.5, "The probe's poses are noisy."),
        (preset.mismatch_mm > 1.5, "The heart's shape differs much from the pre-operative images."),
        (preset.surgery.retraction_mm > 0, "A retractor presses on the heart."),
        (preset.surgery.load_mm != 0, "The heart is filled otherwise than in the pre-operative images."),
        (preset.contraction != (1.0, 1.0), "The heart contracts otherwise than in the pre-operative images."),
        (preset.still_mm > 0, "A wall that moves in the pre-operative images stands still."),
    )
    return tuple(sentence for present, sentence in (*disturbances, *_failures(preset)) if present)


def _failures(preset: Preset) -> tuple[tuple[bool, str], ...]:
    """List failures that begin at some time, each with whether the preset has it."""
    shows = preset.image_failure.shows
    sensors = (("ultrasound probe", preset.probe_failure), ("tool", preset.tool_failure))
    return (
        *((s.lost, f"The {name} is lost to the tracker and not found again.") for name, s in sensors),
        *(
            (s.frozen_s > 0, f"The tracker repeats one pose of the {name} as if fresh.")
            for name, s in sensors
        ),
        (preset.tool_clock.back_s > 0, "The clock of the tool's tracker restarts."),
        (preset.ecg.latency_s > 0, "The ECG's time stamps are late."),
        (shows == "noise", "The ultrasound images show noise in place of the heart from some moment on."),
        (shows == "black", "The ultrasound images are black from some moment on."),
        (shows == "frozen", "One ultrasound image is repeated from some moment on."),
    )
