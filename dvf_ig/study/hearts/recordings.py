"""Hearts of the synthetic worlds, imaged and registered once from a coarse start, without landmarks.

Which hearts are for what: three sealed lists, written before anything was tuned on them. The unit of a
claim is the heart (Efron and Tibshirani 1993, ch. 8: resample what varies independently). Methods are tuned
on TUNING; limits, probabilities and bounds are fitted on THRESHOLD; figures that are stated come from
REPORTED alone. A limit that is changed after a look at reported hearts makes them tuning hearts: new ones
are named here then.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from time import perf_counter
from typing import Any, Literal

import numpy as np
from scipy.optimize import bisect

from data_synth import HeartSpec, SecondWorldSpec, child_rng, second_world_pair, second_world_recording
from data_synth.heart.beating_anatomy import BeatingAnatomy
from data_synth.heart.mismatch import UNTOUCHED, SurgicalChange
from data_synth.heart.motion import HeartMotion, MotionPreset
from data_synth.mr.examination import ExamName
from data_synth.scenario.image_pair import ImagePair, PairSpec, image_pair
from data_synth.scenario.presets import PRESETS, Preset, ScenarioSpec
from data_synth.scenario.recording import ImagedHeart, imaged_heart, phantom_scenario
from dvf_ig.core import HEART_RADIUS_MM, InvalidInputError, Points, Rigid, Scenario, nearest_phase
from dvf_ig.core.arrays import FloatArray, read_only_arrays
from dvf_ig.registration import BoundaryTarget, ModelChannels, channels_from_mr, register, target_from_labels
from dvf_ig.registration.images import VOLUME_SMOOTHING_MM, HeartChannels, images_of_volumes
from dvf_ig.registration.pose_chart import target_errors_mm
from dvf_ig.registration.result import RegistrationResult
from dvf_ig.replay.registration import PreparedRegistration, prepare_registration
from dvf_ig.session import Heart, build_heart, label_map, register_gated_volumes
from dvf_ig.session.ultrasound_registration import images_of_frames
from dvf_ig.study.driver import Settings
from dvf_ig.study.options import option

from .walls import WallErrors, measure_walls

ListName = Literal["tuning", "threshold", "reported"]
"""Lists of hearts."""


def list_option() -> Any:
    """The list of hearts that a study takes."""
    return option("Hearts that are tuned on, that limits come from, or reported.", "reported", flag="--list")


def hearts_option() -> Any:
    """How many hearts of its list a study takes."""
    return option(
        "How many hearts of the list, from its first on (default: all).", None, flag="--hearts", least=1
    )


@dataclass(frozen=True, slots=True)
class HeartList:
    """Hearts of one purpose.

    Attributes:
        name: as the command line names it.
        first_world: seeds of hearts of the first synthetic world.
        second_world: seeds of hearts of the second; it is never tuned on.
        changed: seeds of hearts of the first that have changed since the MR.
        patients: of `acdc-cine`, whose real cines are the MR.
        stacks: seeds of hearts of the first that are imaged as a short-axis stack, with long-axis cines or
            without.
    """

    name: str
    first_world: range
    second_world: range
    changed: range
    patients: tuple[str, ...]
    stacks: range

    def of_world(self, world: str, images: str) -> range:
        """Seeds of the hearts of the "first" or the "second" world for a kind of images.

        Raises:
            InvalidInputError: the list has none there.
        """
        first = self.stacks if images.startswith("sweep-of-sax") else self.first_world
        seeds = self.second_world if world == "second" else first
        if not seeds:
            raise InvalidInputError(
                f"the {self.name} list has no hearts of the {world} world, which is for reporting alone; "
                "take --list reported"
            )
        return seeds


TUNING = HeartList(
    "tuning", range(1001, 1061), range(0), range(1001, 1061), ("002", "003"), range(1001, 1061)
)
THRESHOLD = HeartList(
    "threshold", range(2001, 2201), range(0), range(2101, 2201), ("008", "009"), range(2001, 2201)
)
REPORTED = HeartList(
    "reported",
    range(3181, 3301),
    range(4081, 4161),
    range(9417, 9461),
    ("012", "016", "018"),
    range(3343, 3401),
)
"""Hearts looked at before a table was fitted, or a rule chosen, are left behind: 3001 to 3060 until decision
0019, 3061 to 3120 until 0039 of sweeps, 3121 to 3180 until 0039 of gated volumes; of the second world 4001 to
4040 until 0019, 4041 to 4080 until 0039; of short-axis stacks 3181 to 3220 until their bound was that of the
covariance, 3221 to 3250 until LC2 of their labels counted a third, 3251 to 3342 until the errors of each were
looked at; of changed hearts 9401 to 9416 until a small change was followed only if systole shows it too."""
HEART_LISTS = {chosen.name: chosen for chosen in (TUNING, THRESHOLD, REPORTED)}


def heart_list(name: str) -> HeartList:
    """The list of that name.

    Raises:
        InvalidInputError: there is none.
    """
    if name not in HEART_LISTS:
        raise InvalidInputError(f"there is no list of hearts '{name}'; choose from {', '.join(HEART_LISTS)}")
    return HEART_LISTS[name]


PER_HEART = 100
"""Trials that one heart may have: a trial's number is PER_HEART · heart + place of its condition."""


@dataclass(frozen=True, slots=True)
class Condition:
    """Condition of one recording.

    Attributes:
        quality: preset of the scenario.
        draw: 0: the plain preset; from 1 on: with drawn errors of calibration, clock, anatomy and start.
        change: key of CHANGES; None: the preset's own difference between MR and patient.
    """

    quality: str
    draw: int
    change: str | None = None

    @property
    def disturbed(self) -> bool:
        return self.draw > 0


def conditions_of(settings: Settings) -> list[Condition]:
    """Every condition of a study.

    Args:
        settings: `qualities`; `disturbed`, how many disturbed recordings of each; `changes`, keys of CHANGES,
            none for the preset's own.
    """
    draws, changes = range(settings["disturbed"] + 1), settings["changes"] or [None]
    return [
        Condition(quality, draw, change)
        for quality in settings["qualities"]
        for draw in draws
        for change in changes
    ]


def trial_numbers(hearts: range, settings: Settings) -> list[int]:
    """Number of every trial; those of a heart follow one another."""
    count = len(conditions_of(settings))
    return [PER_HEART * heart + place for heart in hearts for place in range(count)]


def of_trial(number: int, settings: Settings) -> tuple[int, Condition]:
    """Heart and condition of a trial."""
    heart, place = divmod(number, PER_HEART)
    return heart, conditions_of(settings)[place]


@dataclass(frozen=True, slots=True)
class Change:
    """Difference between the heart in the MR and the patient's.

    Attributes:
        mismatch_mm: RMS of a smooth change of shape; surgery: added to it.
        contraction: factors on the heart's contraction, of hearts with even and with odd halves of their
            numbers: either factor meets either motion.
    """

    mismatch_mm: float = 0.0
    surgery: SurgicalChange = UNTOUCHED
    contraction: tuple[float, float] = (1.0, 1.0)


CHANGES = {
    "unchanged": Change(),
    "1.2mm": Change(1.2),
    "5mm": Change(5.0),
    "retraction": Change(surgery=SurgicalChange(retraction_mm=8.0)),
    "other-motion": Change(contraction=(0.6, 1.3)),
}
"""Kinds of hearts that are not the ones in the MR."""
GATED = (0.0, 0.35, 0.75)
"""Gated phases: end-diastole, end-systole, diastasis, where the heart moves least."""
VARIED = HeartSpec("varied")
"""Drawn from a population of healthy, dilated and hypertrophic hearts."""
MOTION: tuple[MotionPreset, MotionPreset] = ("paper5mm", "physiological")
"""Motions of hearts with even and with odd numbers."""
EXAMS: dict[str, tuple[ExamName, ...]] = {
    "sweep-of-sax": ("sax8", "sax10", "sax7", "sax7"),
    "sweep-of-sax+lax": ("sax+lax",),
}
"""Examinations by kind of images, two hearts after two: each comes with both motions."""
EXAM_PHASES = 12
"""Phases of an examination in a study, half of what hospitals take, to image and build a heart in half the
time: the nearest phase is at most 4 % of RR away instead of 2 %."""
SWEEP_S = 14.0
"""Length of a tracked sweep: what a session has seen when it registers first, and as much again."""
START_MM = (4.0, 12.0)
"""Mean error of the start over the targets, drawn evenly."""
DISTURBED_START_MM = (4.0, 50.0)
START_OF = {False: START_MM, True: DISTURBED_START_MM}
DISTURBED_SWEEP_S = (6.0, 14.0)
DISTURBED_MISMATCH_MM = (1.0, 5.0)
DISTURBED_PROBE_MM = (0.0, 2.0)
DISTURBED_LATENCY_S = (0.0, 0.06)
"""Ranges from which disturbed trials draw, evenly: they make the errors between good and lost that a stated
probability is fitted to."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Truth:
    """The true mr_from_tracker, where errors are declared, and a centre (3,) to turn about."""

    truth: Rigid
    targets: Points
    center_mm: FloatArray


def start_with_error(known: Truth, start_mm: float, rng: np.random.Generator) -> Rigid:
    """A pose of that mean target error: random axis, direction and share of rotation.

    Rotation ends at half a turn; what is then missing is translation.
    """
    axis, direction = rng.normal(size=3), rng.normal(size=3)
    share = rng.uniform()
    axis, direction = axis / np.linalg.norm(axis), direction / np.linalg.norm(direction)

    def displaced(size_mm: float) -> Rigid:
        turn = min(size_mm * share / HEART_RADIUS_MM, np.pi) * axis
        return known.truth.perturbed_left(turn, size_mm * (1.0 - share) * direction, known.center_mm)

    def excess_mm(size_mm: float) -> float:
        error_mm = target_errors_mm(displaced(size_mm), known.truth, known.targets).mean()
        return float(error_mm) - start_mm

    if excess_mm(0.0) >= 0.0:
        return known.truth  # the requested error is of rounding's size
    high = 20.0 * start_mm + 1.0
    while excess_mm(high) < 0.0:
        high *= 2.0
    return displaced(bisect(excess_mm, 0.0, high, xtol=1e-12))


def heart_channels(pair: ImagePair) -> HeartChannels:
    """The pre-operative heart of a pair as gated volumes at GATED are registered to it."""
    channels, surface = _preoperative(pair.spec.seed, pair.spec.motion, pair.spec.heart)
    return HeartChannels(channels, pair.center_mm, surface)


@lru_cache(maxsize=2)
def _preoperative(seed: int, motion: MotionPreset, heart: HeartSpec) -> tuple[ModelChannels, BoundaryTarget]:
    """Two are kept: the trials of a heart alternate between its own MR and one with other noise."""
    data = image_pair(PairSpec(seed, motion, heart=heart)).preop
    if data.mr is None:
        raise TypeError("the phantom's pre-operative data hold MR")
    phases = np.array(GATED)
    numbers = nearest_phase(data.mr.timing.fractions, phases).tolist()
    channels = channels_from_mr(data.mr, smoothing_mm=VOLUME_SMOOTHING_MM, phases=numbers)
    return channels, target_from_labels(label_map(data), phases)


@dataclass(frozen=True, slots=True, eq=False)
class RegisteredHeart:
    """A registration with its start, its truth, and what was drawn for it.

    Attributes:
        floor_mm: mean error at the targets of the pose that fits every point of the heart in the images to
            its own place in the MR: what no rigid registration removes. None in the first world, which does
            not state it.
        covered: points of the surface of the covered part of a heart that its MR covers in part; else None.
        walls: errors of the walls, of a heart of CHANGES, or of the second world and imaged whole.
    """

    result: RegistrationResult
    start: Rigid
    known: Truth
    drawn: dict[str, float]
    floor_mm: float | None = None
    covered: Points | None = None
    walls: WallErrors | None = None


def registered_heart(settings: Settings, number: int) -> RegisteredHeart:
    """Make, image and register one heart.

    Args:
        settings: as `heart_trial`.
        number: of the trial.
    Raises:
        InvalidInputError: a disturbed heart of the second world, which is never fitted to.
    """
    seed, condition = of_trial(number, settings)
    if settings["world"] == "second":
        if condition.disturbed:
            raise InvalidInputError("the second world is for reporting; its hearts are not disturbed further")
        rng = child_rng(seed, "heart trial")
        quality: Any = condition.quality
        spec = SecondWorldSpec(seed, quality, _motion(seed), SWEEP_S, exam=_exam(settings["images"], seed))
        return (_second_volumes if settings["images"] == "volumes" else _second_sweep)(spec, rng)
    drawing = seed if condition.draw == 0 else number
    rng = child_rng(drawing, "heart trial")
    images = settings["images"]
    if images == "volumes":
        return _volumes(seed, drawing, condition, rng)
    exam = _exam(images, seed)
    if condition.change is not None:
        return _changed_sweep(seed, condition, CHANGES[condition.change], rng)
    return _sweep(seed, drawing, condition, rng, exam)


def _motion(seed: int) -> Any:
    return MOTION[seed % 2]


def _exam(images: str, seed: int) -> ExamName | None:
    """Return the examination as which a heart's MR is acquired; None if it is whole."""
    return EXAMS[images][seed // 2 % len(EXAMS[images])] if images in EXAMS else None


@lru_cache(maxsize=1)
def _prepared(seed: int, exam: ExamName | None) -> tuple[ImagedHeart, Heart]:
    """A heart of the first world with what is made of its pre-operative images, for all its trials."""
    spec = ScenarioSpec(motion=_motion(seed), seed=seed, heart=VARIED, exam=exam)
    imaged = imaged_heart(spec, phases=None if exam is None else EXAM_PHASES)
    return imaged, build_heart(imaged.preop)


def _sweep(
    seed: int, drawing: int, condition: Condition, rng: np.random.Generator, exam: ExamName | None
) -> RegisteredHeart:
    """The probe's path, speckle and rhythm of disturbed recordings are drawn again, the heart is not."""
    imaged, heart = _prepared(seed, exam)
    preset, drawn = PRESETS[condition.quality], {"sweep_s": SWEEP_S}
    if condition.disturbed:
        preset, drawn = _disturbed(preset, rng)
    same = replace(VARIED, anatomy_seed=seed, motion_seed=seed)
    spec = ScenarioSpec(
        condition.quality, _motion(seed), drawn["sweep_s"], drawing, changed=preset, heart=same, exam=exam
    )
    scenario = phantom_scenario(spec, imaged=imaged)
    return _registered_sweep(scenario, heart, seed, START_OF[condition.disturbed], rng, drawn)


def _changed_sweep(
    seed: int, condition: Condition, change: Change, rng: np.random.Generator
) -> RegisteredHeart:
    """Register a sweep of the patient's heart, which is not the one in the MR."""
    imaged, heart = _prepared(seed, None)
    factor = change.contraction[seed // 2 % 2]
    preset = replace(
        PRESETS[condition.quality],
        mismatch_mm=change.mismatch_mm,
        surgery=change.surgery,
        contraction=(factor, factor),
    )
    same = replace(VARIED, anatomy_seed=seed, motion_seed=seed)
    spec = ScenarioSpec(condition.quality, _motion(seed), SWEEP_S, seed, changed=preset, heart=same)
    scenario = phantom_scenario(spec, imaged=imaged)
    hearts = imaged.anatomy.resting_motion, imaged.of(spec)
    return _registered_sweep(scenario, heart, seed, START_MM, rng, {"sweep_s": SWEEP_S}, hearts)


def _second_sweep(spec: SecondWorldSpec, rng: np.random.Generator) -> RegisteredHeart:
    """Every heart of the second world has changed since the MR; walls are measured of those imaged whole."""
    recording = second_world_recording(spec, phases=EXAM_PHASES)
    heart, room = build_heart(recording.scenario.preop), recording.room
    hearts = (room.heart.resting_motion, room.changed) if spec.exam is None else None
    registered = _registered_sweep(
        recording.scenario, heart, spec.seed, START_MM, rng, {"sweep_s": spec.seconds}, hearts
    )
    return replace(registered, floor_mm=recording.floor.pose_mm)


def _registered_sweep(
    touched: Scenario,
    heart: Heart,
    seed: int,
    start_mm: tuple[float, float],
    rng: np.random.Generator,
    drawn: dict[str, float],
    hearts: tuple[HeartMotion, BeatingAnatomy] | None = None,
) -> RegisteredHeart:
    """Register a sweep; of hearts, the motion of the one in the MR and the patient's, measure the walls."""
    prepared, reference, start = _prepared_sweep(touched, heart, seed, start_mm, rng)
    result, walls = prepared.register(seed=seed), None
    if hearts is not None:
        boundary = images_of_frames(prepared.recording, prepared.frames, perf_counter, warm=False).boundary
        if boundary is None or touched.truth is None:
            raise TypeError("a synthetic recording shows the boundary of blood, and has its truth")
        walls = measure_walls(heart, result, boundary, touched.truth, *hearts)
    covered = None if heart.covered is None else heart.covered.surface
    return RegisteredHeart(result, start, reference, drawn, covered=covered, walls=walls)


def _prepared_sweep(
    touched: Scenario, heart: Heart, seed: int, start_mm: tuple[float, float], rng: np.random.Generator
) -> tuple[PreparedRegistration, Truth, Rigid]:
    """Prepare a registration with its truth and its start, without landmarks: images alone are judged."""
    scenario = replace(touched, landmarks_mr=None, landmarks_tracker=None)
    truth = scenario.truth
    if truth is None:
        raise TypeError("a synthetic scenario has its truth")
    box = truth.surface.vertices_mm[0]
    center = (box.min(axis=0) + box.max(axis=0)) / 2
    reference = Truth(truth.mr_from_tracker_at(0.0), truth.targets.points, center)
    start = start_with_error(reference, float(rng.uniform(*start_mm)), rng)
    return prepare_registration(replace(scenario, start=start), heart=heart, seed=seed), reference, start


def _disturbed(preset: Preset, rng: np.random.Generator) -> tuple[Preset, dict[str, float]]:
    """The preset with errors drawn from the ranges above, and what was drawn."""
    drawn = {
        "sweep_s": float(rng.uniform(*DISTURBED_SWEEP_S)),
        "mismatch_mm": float(rng.uniform(*DISTURBED_MISMATCH_MM)),
        "probe_mm": float(rng.uniform(*DISTURBED_PROBE_MM)),
        "ecg_late_s": float(rng.uniform(*DISTURBED_LATENCY_S)),
    }
    ecg = replace(preset.ecg, latency_s=drawn["ecg_late_s"])
    changed = replace(
        preset,
        mismatch_mm=drawn["mismatch_mm"],
        other_probe_mm=drawn["probe_mm"],
        ecg=ecg,
        other_probe_deg=0.0,
    )
    return changed, drawn


def _volumes(seed: int, drawing: int, condition: Condition, rng: np.random.Generator) -> RegisteredHeart:
    named: Any = condition.quality
    change: Any = str(rng.choice(["none", "deformation", "motion"])) if condition.disturbed else "none"
    late = float(rng.uniform(0.0, 0.06)) if condition.disturbed else 0.0
    same = replace(VARIED, anatomy_seed=seed, motion_seed=seed)
    pair = image_pair(PairSpec(drawing, _motion(seed), named, change, same))
    reference = Truth(pair.mr_from_tracker, pair.targets.points, pair.center_mm)
    volumes = pair.volumes(GATED, phase_error=late)
    start = start_with_error(reference, float(rng.uniform(*START_OF[condition.disturbed])), rng)
    heart, drawn = heart_channels(pair), np.random.default_rng(seed)
    images = images_of_volumes(volumes, grey=True, clock=perf_counter)
    result = register(images, heart, start, rng=drawn, clock=perf_counter)
    return RegisteredHeart(result, start, reference, {"gate_late": late})


def _second_volumes(spec: SecondWorldSpec, rng: np.random.Generator) -> RegisteredHeart:
    pair = second_world_pair(spec)
    reference = Truth(pair.mr_from_tracker, pair.targets.points, pair.center_mm)
    start = start_with_error(reference, float(rng.uniform(*START_MM)), rng)
    result = register_gated_volumes(
        pair.volumes(GATED),
        build_heart(pair.preop),
        start,
        mr=pair.preop.mr,
        seed=spec.seed,
        clock=perf_counter,
    )
    return RegisteredHeart(result, start, reference, {}, pair.floor.pose_mm)
