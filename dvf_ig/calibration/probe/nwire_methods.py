"""All methods of fitting an N-wire recording, and the one with the least cross-validated error."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from dvf_ig.core import (
    DvfIgError,
    InvalidInputError,
    NotConvergedError,
    NWireRecording,
    QualityGateError,
    summarise_errors,
)

from .covariance import time_blocks
from .nwire import NWireOptions, NWireResult, calibrate_method, fit_linear, usable_wires
from .nwire_residuals import MiddleWires, columns_of
from .nwire_solve import NWIRE_METHODS, NWireMethod, fit_map, linear_map


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
