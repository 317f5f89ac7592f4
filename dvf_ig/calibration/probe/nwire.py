"""Spatial calibration of a tracked probe from an N-wire phantom: probe_from_image."""

from dataclasses import dataclass

import numpy as np
from numpy.random import Generator

from dvf_ig.core import (
    BoolArray,
    FloatArray,
    ImageMap,
    InvalidInputError,
    NWireRecording,
    QualityGateError,
    read_only_arrays,
)

from .covariance import MapUncertainty
from .nwire_geometry import (
    MEDIAN_NORM_PER_SIGMA,
    NWireFrames,
    WireErrors,
    measure_errors,
    middle_errors_mm,
    usable_frames,
)
from .nwire_solve import (
    PROBE_METHODS,
    ProbeMethod,
    columns_of,
    fit_map,
    linear_covariance,
    linear_map,
    map_uncertainty,
    shear_deg,
)


@dataclass(frozen=True, slots=True)
class ProbeOptions:
    """How the map is fitted and what is refused.

    Attributes:
        method: "linear" fits nine free numbers to the middle wires and then takes the nearest rotation
            times scale; "orthogonal" fits rotation, translation and two scales to the middle wires;
            "isotropic" the same with one scale; "all-wires" fits them to the in-plane misses of every
            wire, each direction weighed by its scatter.
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


@read_only_arrays
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
        uncertainty: 95 % intervals of the map, from the frames' own scatter.
        rejected: (frame, reason) of every frame that took no part.
    """

    probe_from_image: ImageMap
    matrix: FloatArray
    calibration: WireErrors
    inliers: BoolArray
    method: ProbeMethod
    shear_deg: float
    edge_sd_mm: float
    covariance: FloatArray
    uncertainty: MapUncertainty
    rejected: tuple[tuple[int, str], ...]


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
    return calibrate_agreed(recording, agree_on_frames(recording, rng, options), options)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AgreedFrames:
    """The usable frames of a recording, and which of them agree with one free linear map.

    Attributes:
        seen: usable frames; `keep` (f,) the agreeing ones.
        linear: (3, 3) [u, v, 1] -> probe mm from those.
        covariance, edge_sd_mm: see ProbeResult.
    """

    seen: NWireFrames
    keep: BoolArray
    linear: FloatArray
    covariance: FloatArray
    edge_sd_mm: float


def agree_on_frames(recording: NWireRecording, rng: Generator, options: ProbeOptions) -> AgreedFrames:
    """The frames that every method is fitted to; raises as `calibrate_probe` does."""
    seen = _checked(recording, options)
    keep = _agreeing_frames(seen, rng, options)
    if keep.sum() < max(options.min_frames, len(keep) // 2):
        raise QualityGateError(
            f"only {int(keep.sum())} of {len(keep)} N-wire frames agree on one probe calibration, needed "
            f"half and at least {options.min_frames}; check phantom, sensor and wire order"
        )
    chosen = seen.part(keep)
    linear = linear_map(chosen)
    covariance, edge_sd = linear_covariance(chosen, linear)
    if edge_sd > options.max_edge_sd_mm:
        raise QualityGateError(
            f"the wires leave the probe calibration uncertain by {edge_sd:.2f} mm where they were seen, "
            f"needed at most {options.max_edge_sd_mm:g} mm; let the dots wander over the image"
        )
    return AgreedFrames(seen, keep, linear, covariance, edge_sd)


def calibrate_agreed(recording: NWireRecording, agreed: AgreedFrames, options: ProbeOptions) -> ProbeResult:
    """Fit one method to frames that agree; raises as `calibrate_probe` does."""
    chosen, sensor = agreed.seen.part(agreed.keep), recording.phantom_from_probe.source
    image_map = fit_map(chosen, agreed.linear, sensor, recording.phantom, options.method)
    columns = columns_of(image_map)
    mean = float(middle_errors_mm(columns, chosen).mean())
    if mean > options.max_mean_mm:
        raise QualityGateError(
            f"the middle wires miss by {mean:.2f} mm on average, needed at most {options.max_mean_mm:g} mm; "
            "check the phantom's wiring, its registration and the tracker's latency"
        )
    return ProbeResult(
        probe_from_image=image_map,
        matrix=image_map.matrix,
        calibration=measure_errors(columns, agreed.seen, recording),
        inliers=_inlier_flags(len(recording.phantom_from_probe), agreed.seen, agreed.keep),
        method=options.method,
        shear_deg=shear_deg(agreed.linear),
        edge_sd_mm=agreed.edge_sd_mm,
        covariance=agreed.covariance,
        uncertainty=map_uncertainty(image_map, chosen, recording.phantom, options.method),
        rejected=_rejections(recording, agreed.seen, agreed.keep, columns),
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
    return measure_errors(columns_of(probe_from_image), usable_frames(recording), recording)


def _agreeing_frames(seen: NWireFrames, rng: Generator, options: ProbeOptions) -> BoolArray:
    """(f,) frames that agree: least truncated error over random subsets, then refit until it stands still."""
    count = len(seen.frames)
    size = min(options.subset, count)
    candidates = [
        linear_map(seen.part(np.sort(rng.permutation(count)[:size]))) for _ in range(options.hypotheses)
    ]
    worst = np.stack([middle_errors_mm(m, seen).max(axis=1) for m in candidates])
    best = worst[int(np.median(worst, axis=1).argmin())]
    keep = best <= options.keep_sigma * float(np.median(best)) / MEDIAN_NORM_PER_SIGMA
    for _ in range(50):
        errors = middle_errors_mm(linear_map(seen.part(keep)), seen)
        sigma = float(np.median(errors)) / MEDIAN_NORM_PER_SIGMA
        again = (errors <= max(options.keep_sigma * sigma, 1e-9)).all(axis=1)
        if np.array_equal(again, keep) or again.sum() < 3:
            break
        keep = again
    return np.asarray(keep)


def _inlier_flags(count: int, seen: NWireFrames, keep: BoolArray) -> BoolArray:
    flags = np.zeros(count, dtype=np.bool_)
    flags[seen.frames[keep]] = True
    return flags


def _rejections(
    recording: NWireRecording, seen: NWireFrames, keep: BoolArray, probe_from_pixel: FloatArray
) -> tuple[tuple[int, str], ...]:
    """(frame, reason) of every frame that took no part in the fit."""
    poses = recording.phantom_from_probe
    found = np.isfinite(recording.points_px).all(axis=(1, 2))
    names = [wire.name for wire in recording.phantom.wires]
    out = []
    for i in np.flatnonzero(~found):
        missing = [
            n for n, lost in zip(names, np.isnan(recording.points_px[i]).any(axis=1), strict=True) if lost
        ]
        what = "no wire was found" if len(missing) == len(names) else f"not found: {', '.join(missing)}"
        out.append((int(i), what))
    out += [(int(i), f"{poses.name} is not valid") for i in np.flatnonzero(found & ~poses.valid)]
    worst = middle_errors_mm(probe_from_pixel, seen).max(axis=1)
    out += [
        (
            int(i),
            f"a middle wire misses by {miss:.2f} mm, frames that took part by {worst[keep].max():.2f} mm",
        )
        for i, miss in zip(seen.frames[~keep], worst[~keep], strict=True)
    ]
    return tuple(sorted(out))
