"""The three calibrations of a scenario, each from its recording: tool tip, image, latency."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import numpy as np

from dvf_ig.calibration import (
    LatencyResult,
    NWireResult,
    PivotResult,
    accepted,
    calibrate_nwire,
    calibrate_pivot,
    estimate_latency,
)
from dvf_ig.core import DvfIgError, Scenario


@dataclass(frozen=True, slots=True)
class Calibrations:
    """Every calibration result with its evidence."""

    pivot: PivotResult
    probe: NWireResult
    latency: LatencyResult


def calibrate(scenario: Scenario, seed: int) -> Calibrations:
    """Calibrate tool, probe and latency from their recordings; refusals are the methods' own."""
    rng_pivot, rng_probe = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    with _naming("pivot calibration"):
        pivot = accepted(calibrate_pivot(scenario.pivot, rng=rng_pivot))
    with _naming("probe calibration"):
        probe = accepted(calibrate_nwire(scenario.nwire, rng=rng_probe))
    with _naming("latency calibration"):
        latency = accepted(estimate_latency(scenario.latency))
    return Calibrations(pivot, probe, latency)


@contextmanager
def _naming(stage: str) -> Iterator[None]:
    """Say which calibration refused its recording."""
    try:
        yield
    except DvfIgError as error:
        raise type(error)(f"{stage}: {error}") from error
