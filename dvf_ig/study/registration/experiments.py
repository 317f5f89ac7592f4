"""The experiments of the registration protocol: what each varies, and how its trials are numbered.

A trial is a number: its image pair, its condition and its start follow from that and the study's settings.
Nothing heavy is imported here, so that the command line can list the experiments.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

Condition = dict[str, Any]
Settings = dict[str, Any]

MOTIONS = ("paper5mm", "physiological")
BIN_MM = 2.0
"""Width of the bins of start error."""
FAR_MM = (2.0, 5.0, 8.0, 11.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0)
"""Start errors at which failures are looked for: half of them are meant to fail."""
BASELINE_MM = (3.0, 8.0)
"""Start errors at which the baseline registers as well."""


@dataclass(frozen=True, slots=True)
class CaptureOptions:
    """What the user of `study capture` chooses; the other experiments have nothing to choose.

    Attributes:
        qualities: of the images.
        per_bin: starts in each bin of start error; to_mm: largest start error.
        baseline: whether the baseline registers as well, from `BASELINE_MM`.
    """

    qualities: tuple[str, ...] = ("calm",)
    per_bin: int = 3
    to_mm: float = 20.0
    baseline: bool = False


@dataclass(frozen=True, slots=True)
class Experiment:
    """One experiment of the protocol.

    Attributes:
        letter: what its files call it, under "arm".
        name: of its command, `dvf-ig study NAME`.
        title: what it does, in one sentence.
        seeds: image pairs where nothing else is asked for.
        conditions: motion and options to what each image pair goes through.
        starts_mm: options to the [least, most] start error of each registration under a condition.
        baseline_mm: start errors from which the baseline registers where it is asked for.
    """

    letter: str
    name: str
    title: str
    seeds: int
    conditions: Callable[[str, CaptureOptions], Iterator[Condition]]
    starts_mm: Callable[[CaptureOptions], list[list[float]]]
    baseline_mm: tuple[float, ...] = ()


def settings_of(experiment: Experiment, options: CaptureOptions | None = None) -> Settings:
    """JSON settings of a study; the same settings give the same trials."""
    chosen = options or CaptureOptions()
    baseline_mm = experiment.baseline_mm if chosen.baseline else ()
    return {
        "arm": experiment.letter,
        "conditions": [c for motion in MOTIONS for c in experiment.conditions(motion, chosen)],
        "starts_mm": experiment.starts_mm(chosen),
        "baseline_starts_mm": [[mm, mm] for mm in baseline_mm],
    }


def trials_per_heart(settings: Settings) -> int:
    """Consecutive trials that share the pre-operative heart: all conditions of one motion."""
    return len(settings["conditions"]) // len(MOTIONS) * trials_per_condition(settings)


def trials_per_condition(settings: Settings) -> int:
    """Trials of an image pair under one condition, the baseline's last."""
    return len(settings["starts_mm"]) + len(settings["baseline_starts_mm"])


def trial_numbers(settings: Settings, first_pair: int, pairs: int) -> range:
    """Numbers of the trials of pairs `first_pair`, … under all conditions."""
    block = len(settings["conditions"]) * trials_per_condition(settings)
    return range(first_pair * block, (first_pair + pairs) * block)


def _condition(motion: str, quality: str, images: str, label: str = "", **more: Any) -> Condition:
    return {"motion": motion, "quality": quality, "images": images, "condition": label, **more}


def _same_image(motion: str, _: CaptureOptions) -> Iterator[Condition]:
    yield _condition(motion, "no-mismatch", "same")


def _image_qualities(motion: str, options: CaptureOptions) -> Iterator[Condition]:
    for quality in options.qualities:
        yield _condition(motion, quality, "volumes")


def _gating_errors(motion: str, _: CaptureOptions) -> Iterator[Condition]:
    for error in (0.0, -0.02, 0.02, -0.05, 0.05, -0.1, 0.1):
        yield _condition(motion, "calm", "volumes", f"gate {error:+.0%}", phase_error=error)
    for rr_s in (0.6, 0.8, 1.0, 1.2):
        yield _condition(motion, "calm", "volumes", f"RR {1000 * rr_s:.0f} ms", rr_s=rr_s)


def _tracked_planes(motion: str, _: CaptureOptions) -> Iterator[Condition]:
    for planes in ("one", "shared axis", "off axis", "five"):
        for off_mm in (0.0, 1.0, 2.0) if planes in ("shared axis", "off axis") else (0.0,):
            label = f"{planes}, {off_mm:.0f} mm"
            yield _condition(motion, "calm", "planes", label, planes=planes, calibration_mm=off_mm)
    for lag_s in (0.02, 0.05):
        label = f"off axis, {1000 * lag_s:.0f} ms late"
        yield _condition(motion, "calm", "planes", label, planes="off axis", lag_s=lag_s)


def _failures(motion: str, _: CaptureOptions) -> Iterator[Condition]:
    for quality in ("calm", "poor-image"):
        yield _condition(motion, quality, "volumes")
    for change in ("deformation", "motion"):
        yield _condition(motion, "calm", "volumes", change, change=change)


def _near_starts(_: CaptureOptions) -> list[list[float]]:
    return [[low, low + 2.0] for low in (2.0, 6.0, 10.0)]


def _binned_starts(options: CaptureOptions) -> list[list[float]]:
    starts, low = [], 0.0
    while low < options.to_mm:
        starts += [[low, low + BIN_MM]] * options.per_bin
        low += BIN_MM
    return starts


def _far_starts(_: CaptureOptions) -> list[list[float]]:
    return [[mm, mm] for mm in FAR_MM]


SAME_IMAGE = Experiment(
    "A",
    "same-image",
    "The MR against itself; what is left is the pipeline's own error.",
    3,
    _same_image,
    _near_starts,
)
CAPTURE = Experiment(
    "B",
    "capture",
    "Gated 3-D ultrasound to the phase-matched MR, without landmarks, from starts up to 20 mm off.",
    10,
    _image_qualities,
    _binned_starts,
    baseline_mm=BASELINE_MM,
)
GATING_ERROR = Experiment(
    "D",
    "gating-error",
    "Ultrasound gated up to 10 % of RR early or late, and at other heart rates.",
    3,
    _gating_errors,
    _near_starts,
)
PLANES = Experiment(
    "E",
    "planes",
    "One to five tracked planes, with errors of the probe's calibration and clock.",
    5,
    _tracked_planes,
    _near_starts,
)
FAILURES = Experiment(
    "F",
    "failures",
    "Starts up to 90 mm off, deformed and wrong hearts; are failures known as such?",
    10,
    _failures,
    _far_starts,
)
EXPERIMENTS = (SAME_IMAGE, CAPTURE, GATING_ERROR, PLANES, FAILURES)
"""In the order of the protocol; C, on recorded images, has no command."""
