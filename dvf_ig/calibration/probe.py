"""Spatial calibration of a tracked probe from an N-wire phantom: probe_from_image."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.random import Generator
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    ImageMap,
    InvalidInputError,
    NotConvergedError,
    NWireRecording,
    QualityGateError,
)

from .nwire import (
    MEDIAN_NORM_PER_SIGMA,
    NWireFrames,
    WireErrors,
    in_plane_misses_mm,
    measure_errors,
    middle_errors_mm,
    usable_frames,
)

ProbeMethod = Literal["linear", "orthogonal", "isotropic", "all-wires"]
PROBE_METHODS: tuple[ProbeMethod, ...] = ("linear", "orthogonal", "isotropic", "all-wires")


@dataclass(frozen=True, slots=True)
class ProbeOptions:
    """How the map is fitted and what is refused.

    Attributes:
        method: "linear" fits nine free numbers to the middle wires and then takes the nearest rotation
            times scale; "orthogonal" fits rotation, translation and two scales to the middle wires;
            "isotropic" the same with one scale; "all-wires" fits them to the in-plane misses of every wire.
        hypotheses: random subsets of frames tried before the fit.
        subset: frames a subset.
        keep_sigma: frames whose worst middle wire lies within this many robust sigmas take part.
        min_frames: fewest frames accepted.
        max_mean_mm: largest accepted mean 3-D error of the frames that take part.
        max_edge_sd_mm: largest accepted standard deviation of the map over the region the dots covered.
    """

    method: ProbeMethod = "orthogonal"
    hypotheses: int = 200
    subset: int = 6
    keep_sigma: float = 5.0
    min_frames: int = 10
    max_mean_mm: float = 2.0
    max_edge_sd_mm: float = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class ProbeResult:
    """An image calibration with its evidence.

    Attributes:
        probe_from_image: rotation, translation and pixel size.
        matrix: (4, 4) the same in mm per pixel, third column of unit norm.
        calibration: errors over every usable frame of the recording, outliers included.
        inliers: (n,) frames of the recording that took part in the fit.
        method: what was fitted.
        shear_deg: how far from orthogonal the free linear fit was; large values mean bad data.
        edge_sd_mm: standard deviation of the map at the worst corner of the region the dots covered.
        covariance: (9, 9) of the linear map [u-column, v-column, origin] in mm per px, mm per px, mm.
    """

    probe_from_image: ImageMap
    matrix: FloatArray
    calibration: WireErrors
    inliers: BoolArray
    method: ProbeMethod
    shear_deg: float
    edge_sd_mm: float
    covariance: FloatArray


def calibrate_probe(
    recording: NWireRecording, *, rng: Generator, options: ProbeOptions | None = None
) -> ProbeResult:
    """Fit probe_from_image to the wires seen, leaving out frames that disagree with the rest.

    Args:
        recording: wire dots (px) and phantom_from_probe (mm) of each frame.
        rng: draws subsets of frames.
        options: see ProbeOptions.
    Raises:
        InvalidInputError: too few usable frames, or wires that do not form N patterns.
        QualityGateError: dots that do not spread over the image, image axes far from orthogonal, or a
            large error.
        NotConvergedError: the refinement did not settle.
    Source: Comeau 1998 / Chen 2009 (N-wire, linear); Carbajal 2013 (all wires, in plane).
    """
    options = options or ProbeOptions()
    seen = _checked(recording, options)
    keep = _agreeing_frames(seen, rng, options)
    if keep.sum() < max(options.min_frames, len(keep) // 2):
        raise QualityGateError(
            f"only {int(keep.sum())} of {len(keep)} N-wire frames agree on one probe calibration, needed "
            f"half and at least {options.min_frames}; check phantom, sensor and wire order"
        )
    chosen = _subset(seen, keep)
    linear = _linear_map(chosen)
    covariance, edge_sd = _linear_covariance(chosen, linear)
    if edge_sd > options.max_edge_sd_mm:
        raise QualityGateError(
            f"the wires leave the probe calibration uncertain by {edge_sd:.2f} mm where they were seen, "
            f"needed at most {options.max_edge_sd_mm:g} mm; let the dots wander over the image"
        )
    image_map = _fit(chosen, linear, recording, options)
    mean = float(middle_errors_mm(_columns(image_map), chosen).mean())
    if mean > options.max_mean_mm:
        raise QualityGateError(
            f"the middle wires miss by {mean:.2f} mm on average, needed at most {options.max_mean_mm:g} mm; "
            "check the phantom's wiring, its registration and the tracker's latency"
        )
    return ProbeResult(
        probe_from_image=image_map,
        matrix=image_map.matrix,
        calibration=measure_errors(_columns(image_map), seen, recording),
        inliers=_inlier_flags(len(recording.phantom_from_probe), seen, keep),
        method=options.method,
        shear_deg=_shear_deg(linear),
        edge_sd_mm=edge_sd,
        covariance=covariance,
    )


def _checked(recording: NWireRecording, options: ProbeOptions) -> NWireFrames:
    """The usable frames, or the reason why there can be no calibration."""
    if options.method not in PROBE_METHODS:
        listed = ", ".join(PROBE_METHODS)
        raise InvalidInputError(f"probe method '{options.method}' is unknown; choose {listed}")
    seen = usable_frames(recording)
    if len(seen.frames) < options.min_frames:
        raise InvalidInputError(
            f"{len(seen.frames)} usable N-wire frames of {len(recording.phantom_from_probe)}; needed at "
            f"least {options.min_frames}: record more of the phantom"
        )
    return seen


def validate_probe(probe_from_image: ImageMap, recording: NWireRecording) -> WireErrors:
    """Errors of a given calibration on a recording; every usable frame counts, none is rejected.

    Raises:
        InvalidInputError: no usable frame, or a calibration of another sensor.
    """
    sensor = recording.phantom_from_probe.source
    if probe_from_image.rigid.target != sensor:
        raise InvalidInputError(
            f"the image calibration belongs to sensor '{probe_from_image.rigid.target}', the recording "
            f"tracks '{sensor}'; use the calibration of the same probe"
        )
    return measure_errors(_columns(probe_from_image), usable_frames(recording), recording)


def _agreeing_frames(seen: NWireFrames, rng: Generator, options: ProbeOptions) -> BoolArray:
    """(f,) frames that agree: least truncated error over random subsets, then refit until it stands still."""
    count = len(seen.frames)
    size = min(options.subset, count)
    candidates = [
        _linear_map(_subset(seen, np.sort(rng.permutation(count)[:size]))) for _ in range(options.hypotheses)
    ]
    worst = np.stack([middle_errors_mm(m, seen).max(axis=1) for m in candidates])
    best = worst[int(np.median(worst, axis=1).argmin())]
    keep = best <= options.keep_sigma * float(np.median(best)) / MEDIAN_NORM_PER_SIGMA
    for _ in range(50):
        errors = middle_errors_mm(_linear_map(_subset(seen, keep)), seen)
        sigma = float(np.median(errors)) / MEDIAN_NORM_PER_SIGMA
        again = (errors <= max(options.keep_sigma * sigma, 1e-9)).all(axis=1)
        if np.array_equal(again, keep) or again.sum() < 3:
            break
        keep = again
    return np.asarray(keep)


def _linear_map(seen: NWireFrames) -> FloatArray:
    """(3, 3) [u, v, 1] -> probe mm by least squares on the middle wires."""
    design = _design(seen)
    return np.asarray(np.linalg.lstsq(design, seen.middle_probe_mm.reshape(-1, 3), rcond=None)[0].T)


def _linear_covariance(seen: NWireFrames, linear: FloatArray) -> tuple[FloatArray, float]:
    """Covariance of the linear map and its worst standard deviation at the corners of the dots' region."""
    design = _design(seen)
    residual = seen.middle_probe_mm.reshape(-1, 3) - design @ linear.T
    freedom = max(1, len(design) - 3)
    noise = residual.T @ residual / freedom
    inverse = np.linalg.pinv(design.T @ design)
    low, high = design[:, :2].min(axis=0), design[:, :2].max(axis=0)
    corners = np.array([[u, v, 1.0] for u in (low[0], high[0]) for v in (low[1], high[1])])
    leverage = np.einsum("ci,ij,cj->c", corners, inverse, corners)
    return np.kron(inverse, noise), float(np.sqrt(leverage.max() * np.trace(noise)))


def _fit(seen: NWireFrames, linear: FloatArray, recording: NWireRecording, options: ProbeOptions) -> ImageMap:
    """The map of the chosen method, started from the free linear one."""
    matrix = np.eye(4)
    matrix[:3, [0, 1, 3]] = linear
    try:
        start = ImageMap.from_matrix(matrix, recording.phantom_from_probe.source)
    except InvalidInputError as exc:
        raise QualityGateError(
            f"the wires give image axes {_shear_deg(linear):.2f}° off orthogonal, needed at most 1°; "
            "check wire order, phantom geometry and image spacing"
        ) from exc
    if options.method == "linear":
        return ImageMap(start.rigid, start.scale_mm_per_px)
    isotropic = options.method == "isotropic"

    def residual(step: FloatArray) -> FloatArray:
        columns = _columns(_stepped(start, step, isotropic))
        if options.method == "all-wires":
            return in_plane_misses_mm(columns, seen, recording.phantom).ravel()
        return np.asarray((_design(seen) @ columns.T - seen.middle_probe_mm.reshape(-1, 3)).ravel())

    found = least_squares(residual, np.zeros(7 if isotropic else 8), method="lm", xtol=1e-12, ftol=1e-12)
    if not found.success:
        raise NotConvergedError(f"the probe calibration did not settle ({found.message}); record more frames")
    return _stepped(start, found.x, isotropic)


def _stepped(start: ImageMap, step: FloatArray, isotropic: bool) -> ImageMap:
    """`start` turned and moved by step[:6] (rad, mm) with its pixel sizes scaled by exp(step[6:])."""
    rigid = start.rigid
    turned = Rotation.from_rotvec(step[:3]).as_matrix() @ rigid.rotation
    scale = start.scale_mm_per_px
    if isotropic:
        scale = np.full(2, np.sqrt(scale.prod()))
    moved = type(rigid)(rigid.target, rigid.source, turned, rigid.translation_mm + step[3:6])
    return ImageMap(moved, scale * np.exp(step[6:]))


def _columns(image_map: ImageMap) -> FloatArray:
    """(3, 3) columns u, v and origin of the map's matrix."""
    return np.asarray(image_map.matrix[:3, [0, 1, 3]])


def _design(seen: NWireFrames) -> FloatArray:
    """(f·patterns, 3) rows [u, v, 1] of the middle wires."""
    flat = seen.middle_pixels.reshape(-1, 2)
    return np.column_stack([flat, np.ones(len(flat))])


def _subset(seen: NWireFrames, which: np.ndarray[tuple[int], np.dtype[np.bool_ | np.intp]]) -> NWireFrames:
    return NWireFrames(
        seen.frames[which],
        seen.pixels[which],
        seen.middle_probe_mm[which],
        seen.rotations[which],
        seen.translations_mm[which],
    )


def _inlier_flags(count: int, seen: NWireFrames, keep: BoolArray) -> BoolArray:
    flags = np.zeros(count, dtype=np.bool_)
    flags[seen.frames[keep]] = True
    return flags


def _shear_deg(linear: FloatArray) -> float:
    u, v = linear[:, 0], linear[:, 1]
    cosine = float(u @ v / max(1e-30, float(np.linalg.norm(u) * np.linalg.norm(v))))
    return abs(90.0 - float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))))
