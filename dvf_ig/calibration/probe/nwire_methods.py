"""Every way of fitting an N-wire recording side by side, and the one that its own frames speak for."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.random import Generator

from dvf_ig.calibration.error_summary import summarise
from dvf_ig.core import DvfIgError, InvalidInputError, NotConvergedError, NWireRecording, QualityGateError

from .nwire import ProbeOptions, ProbeResult, agree_on_frames, calibrate_agreed
from .nwire_geometry import middle_errors_mm, usable_frames
from .nwire_solve import PROBE_METHODS, ProbeMethod, columns_of, fit_map, linear_map

FOLDS = 10
"""Pieces of the recording, each one stretch of time: neighbouring frames are alike and stay together."""


@dataclass(frozen=True, slots=True, eq=False)
class ProbeVariants:
    """All methods on one recording.

    Attributes:
        results: of the methods that gave one.
        cross_validated_mm: mean of the lowest 95 % of the 3-D errors of the middle wires, each frame under
            a fit without its stretch of time.
        refused: why the other methods gave none.
        chosen: the method with the least cross-validated error; validation recordings play no part.
    """

    results: dict[ProbeMethod, ProbeResult]
    cross_validated_mm: dict[ProbeMethod, float]
    refused: dict[ProbeMethod, str]
    chosen: ProbeMethod

    @property
    def best(self) -> ProbeResult:
        return self.results[self.chosen]


def compare_methods(
    recording: NWireRecording, *, rng: Generator, options: ProbeOptions | None = None
) -> ProbeVariants:
    """Calibrate with every method on the same frames and choose by cross-validation.

    Args:
        recording: see `calibrate_probe`.
        rng: draws subsets of frames, once for all methods.
        options: see ProbeOptions; its method is not used.
    Raises:
        InvalidInputError, QualityGateError, NotConvergedError: when no method gives a calibration, what the
            first one says.
    """
    options = options or ProbeOptions()
    agreed = agree_on_frames(recording, rng, options)
    results: dict[ProbeMethod, ProbeResult] = {}
    errors: dict[ProbeMethod, float] = {}
    refused: dict[ProbeMethod, str] = {}
    failure: DvfIgError | None = None
    for method in PROBE_METHODS:
        try:
            found = calibrate_agreed(recording, agreed, replace(options, method=method))
            errors[method] = cross_validated_mm(recording, found)
            results[method] = found
        except (InvalidInputError, QualityGateError, NotConvergedError) as exc:
            refused[method] = str(exc)
            failure = failure or exc
    if failure is not None and not results:
        raise failure
    return ProbeVariants(results, errors, refused, min(results, key=lambda m: errors[m]))


def cross_validated_mm(recording: NWireRecording, found: ProbeResult, folds: int = FOLDS) -> float:
    """Mean of the lowest 95 % of the middle wires' errors, each frame under a fit without its piece.

    Every usable frame counts; only those that took part in `found` are fitted to.
    """
    seen = usable_frames(recording)
    inlier = found.inliers[seen.frames]
    sensor = recording.phantom_from_probe.source
    errors = []
    for piece in np.array_split(np.arange(len(seen.frames)), folds):
        fitted = inlier.copy()
        fitted[piece] = False
        rest = seen.part(fitted)
        image_map = fit_map(rest, linear_map(rest), sensor, recording.phantom, found.method)
        errors.append(middle_errors_mm(columns_of(image_map), seen.part(piece)).ravel())
    return summarise(np.concatenate(errors)).mean95_mm
