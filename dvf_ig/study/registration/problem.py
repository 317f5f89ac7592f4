"""One synthetic registration problem: what is registered to what, how, and the truth of it."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from time import perf_counter
from typing import Any

import numpy as np

from data_synth.heart.clock import two_segment_phase
from data_synth.heart.heart_spec import HeartSpec
from data_synth.heart.motion import MotionPreset
from data_synth.scenario.image_pair import ImagePair, PairSpec, image_pair, plane_views
from data_synth.seeds import child_rng
from data_synth.ultrasound.presets import PROBES
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.cardiac import retime
from dvf_ig.core import (
    FloatArray,
    Grid,
    ImageMap,
    Points,
    Rigid,
    TrackedVolume,
    Volume,
    VolumeSeries,
    nearest_phase,
    read_only_arrays,
)
from dvf_ig.registration import (
    VOLUME_SMOOTHING_MM,
    BoundaryTarget,
    HeartChannels,
    Level,
    ModelChannels,
    RegistrationResult,
    TrackedImages,
    UltrasoundImages,
    boundary_points,
    channels_from_mr,
    images_of_volumes,
    prepare_slices,
    register,
    target_from_labels,
)
from dvf_ig.session.heart import label_map

GATED = (0.0, 0.35, 0.75)
"""Gated phases: end-diastole, end-systole, diastasis, where the heart moves least."""
PLANE_PITCHES_MM, PLANE_SMOOTHING_MM = (3.0, 2.0), 2.0
"""Coarse and fine pixels of tracked planes, and the smoothing of the model's channels."""

Register = Callable[[Rigid, np.random.Generator], RegistrationResult]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class RegistrationProblem:
    """One registration with known truth: its data, its targets, and the call that solves it.

    Attributes:
        truth: mr_from_tracker.
        targets: where errors are declared, frame "mr".
        center_mm: (3,) centre of the heart box.
        register: (start, rng) to a result.
        fixed, mask, moving: one ultrasound volume in frame "tracker" and the MR of its phase, for baselines.
    """

    truth: Rigid
    targets: Points
    center_mm: FloatArray
    register: Register
    fixed: Volume | None = None
    mask: Volume | None = None
    moving: Volume | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _PreOperative:
    """The pre-operative heart: MR, wall and blood, and both as gated volumes need them."""

    mr: VolumeSeries
    labels: VolumeSeries
    gated: ModelChannels
    surface: BoundaryTarget


@lru_cache(maxsize=2)
def _preoperative(seed: int, motion: MotionPreset, heart: HeartSpec) -> _PreOperative:
    """Two are kept: the trials of a heart by turns have its own MR and one of other noise."""
    data = image_pair(PairSpec(seed, motion, heart=heart)).preop
    if data.mr is None:
        raise TypeError("the phantom's pre-operative data hold MR")
    mr, labels = data.mr, label_map(data)
    numbers = [_nearest(mr, phase) for phase in GATED]
    gated = channels_from_mr(mr, smoothing_mm=VOLUME_SMOOTHING_MM, phases=numbers)
    return _PreOperative(mr, labels, gated, target_from_labels(labels, np.array(GATED)))


@lru_cache(maxsize=2)
def _channels(seed: int, motion: MotionPreset, heart: HeartSpec, smoothing_mm: float) -> ModelChannels:
    return channels_from_mr(_preoperative(seed, motion, heart).mr, smoothing_mm=smoothing_mm)


def make_problem(pair_seed: int, condition: dict[str, Any]) -> RegistrationProblem:
    """The registration problem of an image pair under a condition of `experiments`."""
    pair = image_pair(
        PairSpec(
            pair_seed,
            condition["motion"],
            condition["quality"],
            condition.get("change", "none"),
            HeartSpec(condition.get("heart", "standard")),
        )
    )
    kind = condition["images"]
    if kind == "same":
        return _same_image(pair)
    if kind == "planes":
        return _planes(pair, condition)
    return _volumes(pair, condition)


def _volumes(pair: ImagePair, condition: dict[str, Any]) -> RegistrationProblem:
    """Gated 3-D images, the MR of their phases, and how late the gate is."""
    error: float | list[float] = condition.get("phase_error", 0.0)
    if "rr_s" in condition:
        error = _retiming_error(pair, condition["rr_s"]).tolist()
    return volume_problem(pair, pair.volumes(GATED, phase_error=error))


def volume_problem(pair: ImagePair, volumes: tuple[TrackedVolume, ...]) -> RegistrationProblem:
    """Registration of gated 3-D images of a pair, at GATED."""
    preop = _preoperative(pair.spec.seed, pair.spec.motion, pair.spec.heart)
    return _problem_with(pair, volumes, preop, preop.surface)


def _problem_with(
    pair: ImagePair, volumes: tuple[TrackedVolume, ...], preop: _PreOperative, surface: BoundaryTarget | None
) -> RegistrationProblem:
    heart, mr = HeartChannels(preop.gated, pair.center_mm, surface), preop.mr

    def solve(start: Rigid, rng: np.random.Generator) -> RegistrationResult:
        images = images_of_volumes(volumes, grey=True, clock=perf_counter)
        return register(images, heart, start, rng=rng, clock=perf_counter)

    first = volumes[0]
    return RegistrationProblem(
        pair.mr_from_tracker,
        pair.targets.points,
        pair.center_mm,
        solve,
        in_tracker(first.image, first.tracker_from_image),
        in_tracker(first.mask, first.tracker_from_image),
        mr.phase(_nearest(mr, first.model_phase)),
    )


def _retiming_error(pair: ImagePair, rr_s: float) -> FloatArray:
    """How far the true heart is ahead of the retimed phase at each gate, at another heart rate.

    The true heart shortens its systole by its own law (`data_synth`); the method knows the usual one.
    """
    anatomy = pair.before
    phi = np.linspace(0.0, 1.0, 2000, endpoint=False)
    estimated = retime(phi, rr_s, anatomy.rr_s, anatomy.es_fraction, mode="two-segment")
    true = two_segment_phase(phi, np.full_like(phi, rr_s), anatomy.rr_s, anatomy.es_fraction, 0.0028)
    return np.array([np.interp(gate, estimated, true - estimated) for gate in GATED])


def _same_image(pair: ImagePair) -> RegistrationProblem:
    """The pipeline alone: "ultrasound" with the model's own channel as grey levels, through a tracker.

    Rounded with dither (Roberts 1962): without noise, plain rounding draws contours that LC2 would match.
    """
    preop = _preoperative(pair.spec.seed, pair.spec.motion, pair.spec.heart)
    tracker_from_mr, grid = pair.mr_from_tracker.inverse(), preop.mr.grid
    pose = Rigid("tracker", "mr", tracker_from_mr.rotation, tracker_from_mr.translation_mm)
    volumes, rng = [], child_rng(pair.spec.seed, "dither")
    for phase, channels in zip(GATED, preop.gated.values, strict=True):
        level = channels[..., 0] - channels[..., 0].min()
        grey = np.floor(level * (255 / level.max()) + rng.random(level.shape)).astype(np.uint8)
        mask = Volume(grid, np.ones(grid.shape, dtype=np.uint8))
        volumes.append(TrackedVolume(Volume(grid, grey), mask, pose, phase))
    # blood is bright in MR: the boundaries that ultrasound shows do not exist here
    return _problem_with(pair, tuple(volumes), preop, surface=None)


def _planes(pair: ImagePair, condition: dict[str, Any]) -> RegistrationProblem:
    """Cine loops of a few tracked planes; calibration off at the fan's centre, clock late."""
    preop, probe = _preoperative(pair.spec.seed, pair.spec.motion, pair.spec.heart), PROBES["apical"]
    mr = preop.mr
    if not isinstance(probe, SectorProbe):
        raise TypeError("the apical probe makes planes")
    views = plane_views(pair.now, condition["planes"], child_rng(pair.spec.seed, "pair planes"))
    lag_s = condition.get("lag_s", 0.0)
    phases = mr.timing.fractions
    sequence, model_phase = pair.planes(views, list(phases), probe=probe, phase_error=lag_s / mr.timing.rr_s)
    image_map = _miscalibrated(probe, condition.get("calibration_mm", 0.0), pair.spec.seed)
    stream = sequence.stream("tracker", "probe")
    images = sequence.images
    if images is None:
        raise TypeError("a cine loop has images")
    mask = probe.fan.mask(*images.shape[1:])
    tracked = TrackedImages(images, stream.rotations, stream.translations_mm, model_phase, sequence.t_s)
    levels = [
        Level(prepare_slices(tracked, mask, image_map, pitch_mm=pitch), pitch) for pitch in PLANE_PITCHES_MM
    ]
    channels = _channels(pair.spec.seed, pair.spec.motion, pair.spec.heart, PLANE_SMOOTHING_MM)
    heart = HeartChannels(channels, pair.center_mm, target_from_labels(preop.labels, model_phase))

    def solve(start: Rigid, rng: np.random.Generator) -> RegistrationResult:
        images = UltrasoundImages(levels[0], levels[1], boundary_points(levels[1].slices))
        return register(images, heart, start, rng=rng, clock=perf_counter)

    return RegistrationProblem(pair.mr_from_tracker, pair.targets.points, pair.center_mm, solve)


def _miscalibrated(probe: SectorProbe, off_mm: float, seed: int) -> ImageMap:
    """probe_from_image whose fan centre lies `off_mm` from where it is, in a random direction."""
    rng = child_rng(seed, "pair calibration")
    direction = rng.normal(size=3)
    shift = off_mm * direction / np.linalg.norm(direction)
    true = probe.plane_from_image
    rigid = Rigid("probe", "image", true.rigid.rotation, true.rigid.translation_mm + shift)
    return ImageMap(rigid, true.scale_mm_per_px)


def _nearest(mr: VolumeSeries, phase: float) -> int:
    return int(nearest_phase(mr.timing.fractions, np.array([phase]))[0])


def in_tracker(volume: Volume, tracker_from_image: Rigid) -> Volume:
    """The same voxels on a grid in the frame "tracker"."""
    grid = volume.grid
    return Volume(
        Grid(
            "tracker",
            grid.shape,
            tracker_from_image.apply_array(grid.origin_mm),
            grid.spacing_mm,
            tracker_from_image.rotation @ grid.direction,
        ),
        volume.values,
    )
