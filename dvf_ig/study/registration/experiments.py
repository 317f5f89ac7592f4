"""The arms of the registration protocol: what is varied in each, and one trial of any of them.

A trial is a number: its image pair, its condition and its start follow from that and the study's settings.
The image pair stays in memory while its trials are worked through.
"""

import json
from collections.abc import Iterator
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np

from data_synth.seeds import child_rng
from dvf_ig.core import DvfIgError, FloatArray, NotConvergedError, Rigid
from dvf_ig.registration import HEART_RADIUS_MM, pose_difference, target_errors_mm

from .baselines import mattes
from .scene import Scene, make_scene
from .summary import BIN_MM

Line = dict[str, Any]
Condition = dict[str, Any]
Settings = dict[str, Any]

MOTIONS = ("paper5mm", "physiological")
FAR_MM = (2.0, 5.0, 8.0, 11.0, 20.0, 30.0, 40.0, 50.0, 60.0, 70.0, 80.0, 90.0)
"""Starts of arm F: half of them are meant to fail."""


def conditions_of(arm: str, qualities: tuple[str, ...]) -> list[Condition]:
    """What an arm goes through for each image pair, one motion after the other."""
    if arm == "A":
        return [_condition(m, "no-mismatch", "same") for m in MOTIONS]
    if arm == "B":
        return [_condition(m, q, "volumes") for m, q in product(MOTIONS, qualities)]
    if arm == "D":
        return [c for motion in MOTIONS for c in _gating_conditions(motion)]
    if arm == "E":
        return [c for motion in MOTIONS for c in _plane_conditions(motion)]
    return [c for motion in MOTIONS for c in _failure_conditions(motion)]


def _gating_conditions(motion: str) -> Iterator[Condition]:
    for error in (0.0, -0.02, 0.02, -0.05, 0.05, -0.1, 0.1):
        yield _condition(motion, "calm", "volumes", f"gate {error:+.0%}", phase_error=error)
    for rr_s in (0.6, 0.8, 1.0, 1.2):
        yield _condition(motion, "calm", "volumes", f"RR {1000 * rr_s:.0f} ms", rr_s=rr_s)


def _failure_conditions(motion: str) -> Iterator[Condition]:
    for quality in ("calm", "poor-image"):
        yield _condition(motion, quality, "volumes")
    for change in ("deformation", "motion"):
        yield _condition(motion, "calm", "volumes", change, change=change)


def _plane_conditions(motion: str) -> Iterator[Condition]:
    for planes in ("one", "shared axis", "off axis", "five"):
        for off_mm in (0.0, 1.0, 2.0) if planes in ("shared axis", "off axis") else (0.0,):
            label = f"{planes}, {off_mm:.0f} mm"
            yield _condition(motion, "calm", "planes", label, planes=planes, calibration_mm=off_mm)
    for lag_s in (0.02, 0.05):
        label = f"off axis, {1000 * lag_s:.0f} ms late"
        yield _condition(motion, "calm", "planes", label, planes="off axis", lag_s=lag_s)


def _condition(motion: str, quality: str, images: str, label: str = "", **more: Any) -> Condition:
    return {"motion": motion, "quality": quality, "images": images, "condition": label, **more}


def starts_of(arm: str, per_bin: int, to_mm: float) -> list[list[float]]:
    """[least, most] start error in mm of each start of an image pair."""
    if arm == "B":
        bins = np.arange(0.0, to_mm, BIN_MM)
        return [[float(low), float(low) + BIN_MM] for low in bins for _ in range(per_bin)]
    if arm == "F":
        return [[mm, mm] for mm in FAR_MM]
    return [[2.0 * k + 2.0, 2.0 * k + 4.0] for k in range(0, 5, 2)]


def settings_of(arm: str, qualities: tuple[str, ...], per_bin: int, to_mm: float, baseline: bool) -> Settings:
    """JSON settings of a study; the same settings give the same trials."""
    return {
        "arm": arm,
        "conditions": conditions_of(arm, qualities),
        "starts_mm": starts_of(arm, per_bin, to_mm),
        "baseline_starts_mm": [[3.0, 3.0], [8.0, 8.0]] if baseline and arm == "B" else [],
    }


def trials_together(settings: Settings) -> int:
    """Trials that share the heart before: all conditions of a motion."""
    return len(settings["conditions"]) // len(MOTIONS) * _starts(settings)


def _starts(settings: Settings) -> int:
    """Trials of an image pair under one condition."""
    return len(settings["starts_mm"]) + len(settings["baseline_starts_mm"])


def trial_numbers(settings: Settings, first_pair: int, pairs: int) -> range:
    """Numbers of the trials of pairs `first_pair`, … under all conditions."""
    block = len(settings["conditions"]) * _starts(settings)
    return range(first_pair * block, (first_pair + pairs) * block)


def registration_trial(settings: Settings, number: int) -> Line:
    """One registration from a known start; a refusal keeps the line's labels (`trials.Work`)."""
    group, k = divmod(number, _starts(settings))
    pair, which = divmod(group, len(settings["conditions"]))
    condition = settings["conditions"][which]
    starts = settings["starts_mm"]
    ours = k < len(starts)
    low, high = starts[k] if ours else settings["baseline_starts_mm"][k - len(starts)]
    line = {
        "pair": pair,
        "arm": settings["arm"],
        "method": "dvf_ig" if ours else "Mattes MI",
        **{name: condition[name] for name in ("motion", "quality", "condition")},
    }
    scene = _scene(pair, json.dumps(condition))
    rng = child_rng(number, "registration start")
    start = start_at(scene, float(rng.uniform(low, high)), rng)
    line["start_mm"] = _mean_error(scene, start)
    try:
        found = _ours(scene, start, number) if ours else _baseline(scene, start)
    except DvfIgError as exc:
        return {**line, "refused": str(exc)}
    pose = found.pop("pose")
    turn, shift = pose_difference(pose, scene.truth, scene.center_mm)
    return {
        **line,
        "tre_mm": _mean_error(scene, pose),
        "rotation_deg": turn,
        "translation_mm": shift.tolist(),
        **found,
    }


def _ours(scene: Scene, start: Rigid, number: int) -> Line:
    result = scene.register(start, np.random.default_rng(number))
    return {
        "pose": result.target_from_source,
        "stop": result.stop.name,
        "usable": result.stop.usable,
        "success_probability": result.success_probability,
        "seconds": result.seconds,
        "similarity": result.similarity,
        "contrast": result.evidence.z_score,
        "halves_mm": _finite(result.evidence.split_half_mm),
        "phases_mm": _finite(result.evidence.phase_mm),
        "parts_mm": result.evidence.half_volume_mm,
        "edges_mm": result.evidence.boundary_mm,
        "sigma_mm": _finite(_sigma_mm(result.covariance)),
        "evaluations": result.evaluations,
    }


def _baseline(scene: Scene, start: Rigid) -> Line:
    if scene.fixed is None or scene.mask is None or scene.moving is None:
        raise TypeError("this scene has no volume for a baseline")
    found = mattes(scene.fixed, scene.mask, scene.moving, start, scene.center_mm)
    if found.moving_from_fixed is None:
        raise NotConvergedError(f"{found.name}: {found.note}")
    return {"pose": found.moving_from_fixed, "stop": found.note, "seconds": found.seconds}


def _sigma_mm(covariance: FloatArray) -> float:
    """Standard deviation per coordinate at the heart's radius, RMS over the six."""
    variance = np.diag(covariance) * np.array([HEART_RADIUS_MM**2] * 3 + [1.0] * 3)
    return float(np.sqrt(variance.mean()))


def _finite(value: float) -> float | None:
    return float(value) if np.isfinite(value) else None


@lru_cache(maxsize=1)
def _scene(pair: int, condition: str) -> Scene:
    return make_scene(pair, json.loads(condition))


def _mean_error(scene: Scene, pose: Rigid) -> float:
    return float(target_errors_mm(pose, scene.truth, scene.targets).mean())


def start_at(scene: Scene, start_mm: float, rng: np.random.Generator) -> Rigid:
    """A pose of that mean target error: random axis, direction and share of rotation (theory: protocol).

    Rotation ends at half a turn; what is then missing is translation.
    """
    axis, direction = rng.normal(size=3), rng.normal(size=3)
    share = rng.uniform()
    axis, direction = axis / np.linalg.norm(axis), direction / np.linalg.norm(direction)

    def at(size_mm: float) -> Rigid:
        turn = min(size_mm * share / HEART_RADIUS_MM, np.pi) * axis
        return scene.truth.perturbed_left(turn, size_mm * (1.0 - share) * direction, scene.center_mm)

    low, high = 0.0, 20.0 * start_mm + 1.0
    while _mean_error(scene, at(high)) < start_mm:
        high *= 2.0
    for _ in range(60):
        middle = (low + high) / 2
        low, high = (middle, high) if _mean_error(scene, at(middle)) < start_mm else (low, middle)
    return at(low)
