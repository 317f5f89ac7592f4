"""Spatial calibration of a tracked probe from an N-wire phantom: probe_from_image."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from dvf_ig.calibration.inliers import InlierRule, fit_inliers
from dvf_ig.calibration.refusal import Gate, Refusal, RejectedFrame
from dvf_ig.core import (
    BoolArray,
    DvfIgError,
    FloatArray,
    ImageMap,
    InvalidInputError,
    NotConvergedError,
    NWireRecording,
    QualityGateError,
    read_only_arrays,
    summarise_errors,
)

from .covariance import MapUncertainty, time_blocks
from .errors import CalibrationErrors
from .nwire_residuals import MiddleWires, columns_of, wire_errors
from .nwire_solve import (
    NWIRE_METHODS,
    NWireMethod,
    fit_map,
    linear_covariance,
    linear_map,
    map_uncertainty,
    shear_deg,
)
from .tracked_points import TrackedPoints, rejected_frames, require_same_probe, usable_points

HYPOTHESES = 200
"""Random subsets of frames tried before the fit."""
SUBSET = 6
"""Frames in a subset."""
KEEP_SIGMA = 5.0
"""Frames whose worst middle wire lies within this many robust standard deviations are inliers."""
MIN_FRAMES = 10
"""Fewest frames accepted."""
MAX_EDGE_SD_MM = 1.0
"""Largest accepted standard deviation of the map over the region the dots covered."""


@dataclass(frozen=True, slots=True)
class NWireOptions:
    """Options of the N-wire fit and limits of its quality gates.

    Attributes:
        method: "linear" fits nine free numbers to the middle wires and then takes the nearest rotation
            times scale; "orthogonal" fits rotation, translation and two scales to the middle wires;
            "isotropic" does so with one scale; "all-wires" fits them to the in-plane residuals of every
            wire, each direction weighed by its scatter.
        max_mean_mm: largest accepted mean 3-D error of the inliers.
    """

    method: NWireMethod = "orthogonal"
    max_mean_mm: float = 2.0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class NWireResult:
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
        uncertainty: 95 % intervals of the map, from blocks of frames.
        rejected: (frame, reason) of every frame that took no part.
        refusals: the gates that the estimate failed; it must not be used unless there are none.
    """

    probe_from_image: ImageMap
    matrix: FloatArray
    calibration: CalibrationErrors
    inliers: BoolArray
    method: NWireMethod
    shear_deg: float
    edge_sd_mm: float
    covariance: FloatArray
    uncertainty: MapUncertainty
    rejected: tuple[tuple[int, RejectedFrame], ...]
    refusals: tuple[Refusal, ...] = ()


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class LinearFit:
    """Usable frames of a recording, the inliers among them, and the free linear map of the inliers.

    Attributes:
        points: dots of the usable frames.
        inliers: (f,) of those frames.
        linear: (3, 3) [u, v, 1] -> mm at the probe.
        covariance, edge_sd_mm, refusals: see NWireResult.
    """

    points: TrackedPoints
    inliers: BoolArray
    linear: FloatArray
    covariance: FloatArray
    edge_sd_mm: float
    refusals: tuple[Refusal, ...]


def calibrate_nwire(
    recording: NWireRecording, *, rng: Generator, options: NWireOptions | None = None
) -> NWireResult:
    """Fit probe_from_image to the wires seen, leaving out frames that disagree with the rest.

    Args:
        recording: wire dots (px) and phantom_from_probe (mm) of each frame.
        rng: draws subsets of frames.
        options: see NWireOptions.
    Raises:
        InvalidInputError: too few usable frames, or wires that do not form N patterns.
        QualityGateError: no map can be computed: hardly a frame agrees with the others, or image axes far
            from orthogonal. What is computed but fails a gate (too few frames that agree, dots that do not
            spread over the image, a large error) carries its refusals.
        NotConvergedError: the fit did not converge.
    Source: Comeau 1998 / Chen 2009 (N-wire, linear); Carbajal 2013 (all wires, in plane).
    """
    options = options or NWireOptions()
    return calibrate_method(recording, fit_linear(recording, rng, options), options)


def validate_nwire(probe_from_image: ImageMap, recording: NWireRecording) -> CalibrationErrors:
    """Measure the errors of a given calibration on every usable frame of a recording.

    Raises:
        InvalidInputError: no usable frame, or a calibration of another sensor.
    """
    require_same_probe(probe_from_image, recording.phantom_from_probe)
    return wire_errors(columns_of(probe_from_image), usable_wires(recording, 1), recording)


def usable_wires(recording: NWireRecording, least: int) -> TrackedPoints:
    """Select frames with a valid pose and all wires segmented; raise if there are fewer than `least`."""
    shown = f"all {len(recording.phantom.wires)} wires"
    return usable_points(recording.phantom_from_probe, recording.points_px, least, shown)


def fit_linear(recording: NWireRecording, rng: Generator, options: NWireOptions) -> LinearFit:
    """Select the inliers that every method is fitted to; raises as `calibrate_nwire` does."""
    if options.method not in NWIRE_METHODS:
        listed = ", ".join(NWIRE_METHODS)
        raise InvalidInputError(f"probe method '{options.method}' is unknown; choose {listed}")
    points, wires = usable_wires(recording, MIN_FRAMES), MiddleWires.of(recording.phantom)
    inliers = _inliers(points, wires, rng)
    refusals: list[Refusal] = []
    if inliers.sum() < max(MIN_FRAMES, len(inliers) // 2):
        detail = (
            f"only {int(inliers.sum())} of {len(inliers)} N-wire frames agree on one probe calibration, "
            f"needed half and at least {MIN_FRAMES}; check phantom, sensor and wire order"
        )
        if inliers.sum() < SUBSET:
            raise QualityGateError(detail)
        refusals.append(Refusal(Gate.FEW_AGREE, detail))
    chosen = points.part(inliers)
    linear = linear_map(chosen, wires)
    covariance, edge_sd = linear_covariance(chosen, wires, linear)
    if edge_sd > MAX_EDGE_SD_MM:
        detail = (
            f"the wires leave the probe calibration uncertain by {edge_sd:.2f} mm where they were seen, "
            f"needed at most {MAX_EDGE_SD_MM:g} mm; let the dots wander over the image"
        )
        refusals.append(Refusal(Gate.UNCERTAIN, detail))
    return LinearFit(points, inliers, linear, covariance, edge_sd, tuple(refusals))


def calibrate_method(recording: NWireRecording, start: LinearFit, options: NWireOptions) -> NWireResult:
    """Fit one method to the inliers of the linear fit; raises as `calibrate_nwire` does."""
    points, wires = start.points, MiddleWires.of(recording.phantom)
    chosen = points.part(start.inliers)
    image_map = fit_map(chosen, recording.phantom, start.linear, options.method)
    columns = columns_of(image_map)
    missed = _residual_refusals(float(wires.errors_mm(columns, chosen).mean()), options)
    return NWireResult(
        probe_from_image=image_map,
        matrix=image_map.matrix,
        calibration=wire_errors(columns, points, recording),
        inliers=points.recorded(start.inliers, len(recording.phantom_from_probe)),
        method=options.method,
        shear_deg=shear_deg(start.linear),
        edge_sd_mm=start.edge_sd_mm,
        covariance=start.covariance,
        uncertainty=map_uncertainty(image_map, chosen, recording.phantom, options.method),
        rejected=_rejected(recording, points, start.inliers, wires.errors_mm(columns, points).max(axis=1)),
        refusals=start.refusals + missed,
    )


def _residual_refusals(mean_mm: float, options: NWireOptions) -> tuple[Refusal, ...]:
    if mean_mm <= options.max_mean_mm:
        return ()
    detail = (
        f"the middle wires miss by {mean_mm:.2f} mm on average, above the gate of {options.max_mean_mm:g} mm "
        "(--max-residual-mm moves it); check the phantom's wiring, its registration and the tracker's latency"
    )
    return (Refusal(Gate.RESIDUAL, detail),)


def _inliers(points: TrackedPoints, wires: MiddleWires, rng: Generator) -> BoolArray:
    """Select (f,) inliers of the free linear map, starting from the best map of random subsets."""
    count, rule = len(points), InlierRule(KEEP_SIGMA)
    size = min(SUBSET, count)
    candidates = [
        linear_map(points.part(np.sort(rng.permutation(count)[:size])), wires) for _ in range(HYPOTHESES)
    ]
    worst = np.stack([wires.errors_mm(columns, points).max(axis=1) for columns in candidates])
    best = worst[int(np.median(worst, axis=1).argmin())]
    start, _ = rule.select([best], np.ones(count, dtype=np.bool_))
    return fit_inliers(
        lambda inliers, _: linear_map(points.part(inliers), wires),
        lambda columns: [wires.errors_mm(columns, points)],
        start,
        rule,
    ).inliers


def _rejected(
    recording: NWireRecording, points: TrackedPoints, inliers: BoolArray, worst_mm: FloatArray
) -> tuple[tuple[int, RejectedFrame], ...]:
    """List (frame, reason) of frames that took no part in the fit; `worst_mm` (f,) of the middle wires."""
    names = [wire.name for wire in recording.phantom.wires]

    def missing(dots: FloatArray) -> str:
        lost = [name for name, dot in zip(names, dots, strict=True) if np.isnan(dot).any()]
        return "no wire was found" if len(lost) == len(names) else f"not found: {', '.join(lost)}"

    most = worst_mm[inliers].max()
    outliers = {
        int(frame): f"a middle wire misses by {miss:.2f} mm, frames that took part by {most:.2f} mm"
        for frame, miss in zip(points.frames[~inliers], worst_mm[~inliers], strict=True)
    }
    return rejected_frames(recording.phantom_from_probe, recording.points_px, outliers, missing)


@dataclass(frozen=True, slots=True, eq=False)
class NWireVariants:
    """Results of all methods on one recording.

    Attributes:
        results: by method, of those that gave one.
        cross_validated_mm: by method, mean of the lowest 95 % of the middle wires' 3-D errors, each frame
            under a fit without its block of time.
        failed: reasons why the other methods gave none.
        chosen: the method with the least cross-validated error, among those that no gate refuses if there
            are any; validation recordings play no part.
    """

    results: dict[NWireMethod, NWireResult]
    cross_validated_mm: dict[NWireMethod, float]
    failed: dict[NWireMethod, str]
    chosen: NWireMethod

    @property
    def best(self) -> NWireResult:
        return self.results[self.chosen]


def compare_nwire_methods(
    recording: NWireRecording, *, rng: Generator, options: NWireOptions | None = None
) -> NWireVariants:
    """Calibrate with every method on the same frames and choose by cross-validation.

    Args:
        recording: see `calibrate_nwire`.
        rng: draws subsets of frames, once for all methods.
        options: see NWireOptions; its method is not used.
    Raises:
        InvalidInputError, QualityGateError, NotConvergedError: no method gives a calibration; it is the
            first method's.
    """
    options = options or NWireOptions()
    start = fit_linear(recording, rng, options)
    results: dict[NWireMethod, NWireResult] = {}
    errors: dict[NWireMethod, float] = {}
    failed: dict[NWireMethod, str] = {}
    failure: DvfIgError | None = None
    for method in NWIRE_METHODS:
        try:
            result = calibrate_method(recording, start, replace(options, method=method))
            errors[method] = cross_validated_mm(recording, result)
            results[method] = result
        except (InvalidInputError, QualityGateError, NotConvergedError) as exc:
            failed[method] = str(exc)
            failure = failure or exc
    if failure is not None and not results:
        raise failure
    chosen = min(results, key=lambda method: (bool(results[method].refusals), errors[method]))
    return NWireVariants(results, errors, failed, chosen)


def cross_validated_mm(recording: NWireRecording, result: NWireResult) -> float:
    """Average the lowest 95 % of the middle wires' errors, each frame fitted without its block of time.

    Neighbouring frames resemble each other and stay together. Every usable frame counts; only the inliers of
    `result` are fitted to.
    """
    points, wires = usable_wires(recording, 1), MiddleWires.of(recording.phantom)
    inliers = result.inliers[points.frames]
    errors = []
    for block in time_blocks(len(points)):
        fitted = inliers.copy()
        fitted[block] = False
        others = points.part(fitted)
        image_map = fit_map(others, recording.phantom, linear_map(others, wires), result.method)
        errors.append(wires.errors_mm(columns_of(image_map), points.part(block)).ravel())
    return summarise_errors(np.concatenate(errors)).mean95
