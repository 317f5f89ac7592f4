"""Bias of a calibration, and how often its 95 % intervals hold the truth.

One synthetic calibration recording a trial. The unit is the recording.

    dvf-ig study calibration --kind nwire --seeds 200 -o study
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

import numpy as np

from data_synth import CrossWireSpec, Preset, SectorProbe, child_rng, crosswire_recording, nwire_recording
from data_synth.phantoms.wall import WallSpec, wall_recording
from data_synth.phantoms.watertank import watertank_recording
from data_synth.scenario.ground_truth import GroundTruth, draw_ground_truth
from dvf_ig.calibration import MapUncertainty, accepted, calibrate_crosswire, calibrate_wall, estimate_latency
from dvf_ig.calibration.probe.nwire import NWireOptions, calibrate_nwire, compare_nwire_methods
from dvf_ig.calibration.probe.target_fit import TargetResult
from dvf_ig.core import FloatArray, InvalidInputError
from dvf_ig.study.driver import Driver, Result, Rows, Study, Trials, refusals
from dvf_ig.study.options import option, seed_option, seeds_option


@dataclass(frozen=True, kw_only=True)
class CalibrationSettings:
    """Options of the study."""

    kind: Literal["nwire", "wall", "watertank", "cross-wire"] = option("Which calibration.")
    seeds: int = seeds_option(200)
    method: str = option("N-wire: linear, orthogonal, isotropic, all-wires or chosen.", "orthogonal")
    seed: int = seed_option(1)


KINDS = ("nwire", "cross-wire", "wall", "watertank")
GROUPS: dict[str, tuple[str, ...]] = {
    "position_mm": ("lateral_mm", "axial_mm", "elevation_mm"),
    "rotation_deg": ("about_lateral_deg", "about_axial_deg", "about_elevation_deg"),
    "scale_percent": ("column_percent", "row_percent"),
    "lag_ms": ("lag_ms",),
}
"""Numbers that are judged together; positions are those of the middle of the fan."""
_MAP_NAMES = GROUPS["rotation_deg"] + GROUPS["position_mm"] + GROUPS["scale_percent"]
_MAP_UNITS = np.array([180 / np.pi] * 3 + [1.0] * 3 + [100.0] * 2)


@dataclass(frozen=True, slots=True)
class IntervalCoverage:
    """How often the 95 % intervals of one number, or of a group of like ones, held the truth.

    Attributes:
        name: key of GROUPS, or one of its entries.
        intervals: how many were judged.
        share: of them that held the truth.
        bias: mean of estimate minus truth, in the unit of the name; the largest of a group.
        sd: standard deviation of estimate minus truth; of the same member.
        half_width: mean 95 % half-width; root mean square over a group.
    """

    name: str
    intervals: int
    share: float
    bias: float
    sd: float
    half_width: float


def calibration_trial(settings: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """One synthetic calibration recording, calibrated; errors and 95 % half-widths by name.

    Args:
        settings: "kind", one of KINDS; "method" of an N-wire calibration ("chosen": by cross-validation).
        seed: of the ground truth and of the recording.
    Raises:
        InvalidInputError: another kind.
    """
    kind = settings["kind"]
    if kind not in KINDS:
        raise InvalidInputError(f"there is no calibration '{kind}'; choose {', '.join(KINDS)}")
    probe = SectorProbe()
    truth = draw_ground_truth(np.zeros(3), probe.plane_from_image, 150.0, child_rng(seed, "planting"))
    rng = child_rng(seed, str(kind))
    if kind == "watertank":
        return _latency_trial(truth, probe, rng)
    uncertainty, extra = _MAPS[kind](truth, probe, rng, settings)
    middle = np.array(probe.apex_px) + np.array([0.0, 0.5 * (probe.fan.start_px + probe.fan.stop_px)])
    uncertainty = uncertainty.about(middle)
    error = -uncertainty.parameters.step_to(truth.probe_from_image) * _MAP_UNITS
    return {**_line(_MAP_NAMES, error, uncertainty.all_half_widths * _MAP_UNITS), **extra}


def interval_coverage(lines: Sequence[Mapping[str, Any]]) -> list[IntervalCoverage]:
    """Every number, and every group of numbers, of the trials that gave an estimate."""
    good = [line for line in lines if "refused" not in line]
    if not good:
        return []
    single = {}
    for name in good[0]["error"]:
        error = np.array([line["error"][name] for line in good])
        half = np.array([line["half_width"][name] for line in good])
        single[name] = (error, half, _coverage_of(name, error, half))
    out = []
    for group, names in GROUPS.items():
        members = [single[name] for name in names if name in single]
        if not members:
            continue
        inside = np.concatenate([np.abs(error) <= half for error, half, _ in members])
        worst = max((c for _, _, c in members), key=lambda c: abs(c.bias) / max(c.sd, 1e-30))
        width = float(np.sqrt(np.mean([c.half_width**2 for _, _, c in members])))
        out.append(IntervalCoverage(group, len(inside), float(inside.mean()), worst.bias, worst.sd, width))
        if len(members) > 1:
            out += [c for _, _, c in members]
    return out


def _coverage_of(name: str, error: FloatArray, half: FloatArray) -> IntervalCoverage:
    sd = float(error.std(ddof=1)) if len(error) > 1 else 0.0
    inside = float((np.abs(error) <= half).mean())
    return IntervalCoverage(name, len(error), inside, float(error.mean()), sd, float(half.mean()))


def _nwire(
    truth: GroundTruth, probe: SectorProbe, rng: np.random.Generator, settings: Mapping[str, Any]
) -> tuple[MapUncertainty, dict[str, Any]]:
    options = Preset()
    size = (probe.columns, probe.rows)
    recording = nwire_recording(
        truth.probe_from_image, probe.fan, size, options.nwire_tracker, options.nwire, rng
    )
    method = settings["method"]
    if method == "chosen":
        result = accepted(compare_nwire_methods(recording, rng=rng).best)
    else:
        result = accepted(calibrate_nwire(recording, rng=rng, options=NWireOptions(method=method)))
    return result.uncertainty, {"method": result.method}


def _target(
    record: Callable[..., Any],
    spec: CrossWireSpec | WallSpec,
    solve: Callable[..., TargetResult[Any]],
    truth: GroundTruth,
    probe: SectorProbe,
    rng: np.random.Generator,
    _: Mapping[str, Any],
) -> tuple[MapUncertainty, dict[str, Any]]:
    """Record a fixed target and solve it."""
    seen = record(truth.probe_from_image, probe, Preset().nwire_tracker, spec, rng, rendered=False).recording
    poses = seen.sequence.stream("tracker", "probe")
    return accepted(solve(poses, seen.features_px, rng=rng)).uncertainty, {}


def _latency_trial(truth: GroundTruth, probe: SectorProbe, rng: np.random.Generator) -> dict[str, Any]:
    options = Preset()
    recording = watertank_recording(
        truth.probe_from_image, probe.fan, truth.lag_s, options.watertank_tracker, options.watertank, rng
    )
    result = accepted(estimate_latency(recording))
    low, high = result.interval_s
    # an interval need not lie evenly about its estimate: its middle is what is judged
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    line = _line(("lag_ms",), np.array([1000 * (middle - truth.lag_s)]), np.array([1000 * half]))
    return {**line, "estimate_error_ms": 1000 * (result.lag_s - truth.lag_s)}


def _line(names: Sequence[str], error: FloatArray, half: FloatArray) -> dict[str, Any]:
    return {
        "error": dict(zip(names, error.tolist(), strict=True)),
        "half_width": dict(zip(names, half.tolist(), strict=True)),
    }


_MAPS: dict[str, Callable[..., tuple[MapUncertainty, dict[str, Any]]]] = {
    "nwire": _nwire,
    "cross-wire": partial(_target, crosswire_recording, CrossWireSpec(), calibrate_crosswire),
    "wall": partial(_target, wall_recording, WallSpec(), calibrate_wall),
}


def run(settings: CalibrationSettings, driver: Driver) -> Result:
    """Calibrate every seed's recording."""
    method = {"method": settings.method} if settings.kind == "nwire" else {}
    fields = {"kind": settings.kind} | method
    seeds = range(settings.seed, settings.seed + settings.seeds)
    lines = driver.trials(Trials("calibration", fields, calibration_trial), seeds)
    entries = interval_coverage(lines)
    summary = {
        **fields,
        "trials": settings.seeds,
        "seed": settings.seed,
        "refused": sum("refused" in line for line in lines),
        "coverage": entries,
    }
    return Result(summary, _table(entries), {"summary.json": summary}, refusals(lines))


def _table(entries: Sequence[IntervalCoverage]) -> Rows:
    rows: Rows = [("", "in interval", "of", "bias", "SD", "half-width")]
    for entry in entries:
        name = entry.name if entry.name in GROUPS else f"  {entry.name}"
        share, width = f"{100 * entry.share:.1f} %", f"{entry.half_width:.4f}"
        rows.append((name, share, str(entry.intervals), f"{entry.bias:+.4f}", f"{entry.sd:.4f}", width))
    return rows


STUDY = Study(CalibrationSettings, run)
