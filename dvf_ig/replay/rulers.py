"""The three calibrations of a scenario: tool tip, image, latency."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.calibration import (
    LatencyResult,
    PivotResult,
    ProbeResult,
    calibrate_pivot,
    calibrate_probe,
    estimate_latency,
)
from dvf_ig.core import Scenario


@dataclass(frozen=True, slots=True)
class Rulers:
    """Every calibration result with its evidence."""

    pivot: PivotResult
    probe: ProbeResult
    latency: LatencyResult


def calibrate(scenario: Scenario, seed: int) -> Rulers:
    """Calibrate tool, probe and latency from their recordings; refusals are the methods' own."""
    rng_pivot, rng_probe = (np.random.default_rng(s) for s in np.random.SeedSequence(seed).spawn(2))
    return Rulers(
        pivot=calibrate_pivot(scenario.pivot, rng=rng_pivot),
        probe=calibrate_probe(scenario.nwire, rng=rng_probe),
        latency=estimate_latency(scenario.latency),
    )
