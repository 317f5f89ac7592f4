"""Output of `dvf-ig model build` and `check`: numbers with their definitions."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel
    from dvf_ig.preop import ModelCheck

DEFINITIONS = {
    "surface_error_mm": "spline fit error, |d|/|grad d| at random points of the reference triangles, no caps "
    "nor rim; not the error of the anatomy",
    "anatomical_error_mm": "distance between the model's surface and that of the labels, at random points of "
    "both, without the border at which the label image cuts the organ off",
    "caps": "closed openings of the surface at end-diastole: area, area of all caps by the measured "
    "area, depth of what may be missing beyond, middle",
    "normal_error_deg": "grad d against the smooth surface's normal at the nearest point, within 2 mm of it",
    "normal_error_deg.facet": "grad d against the exact distance to the flat facets, at the same points",
    "file_megabytes": "size of the model's file, 10^6 bytes",
    "megabytes": "float32 spline coefficients of all phases, 10^6 bytes",
}


def file_megabytes(path: Path) -> float:
    """Return the size of a file, 10⁶ bytes."""
    return path.stat().st_size / 1e6


def model_payload(
    model: "DvfModel", result: "ModelCheck", seed: int, seconds: float | None, file_mb: float
) -> dict[str, Any]:
    """Build the JSON of `model build` and `model check`."""
    from dvf_ig.io import plain
    from dvf_ig.preop import border_distance_mm, caps_of, potential_at_border

    border_mm = border_distance_mm(model)
    surface = model.reference[model.ed_phase]
    return {
        "surface_error_mm": {
            "mean": result.mean_mm,
            "p99": result.p99_mm,
            "max": result.max_mm,
            "per_phase": result.per_phase_mm.tolist(),
            "per_phase_p99": result.per_phase_p99_mm.tolist(),
        },
        "normal_error_deg": {
            "median": result.normal_median_deg,
            "p95": result.normal_p95_deg,
            "per_phase_p95": result.per_phase_normal_p95_deg.tolist(),
            "facet_median": result.facet_normal_median_deg,
            "facet_p95": result.facet_normal_p95_deg,
        },
        "knot_spacing_mm": model.knot_spacing_mm,
        "megabytes": model.megabytes,
        "file_megabytes": file_mb,
        "phases": model.phases,
        "chambers": [chamber.name for chamber in model.chambers],
        "seconds": seconds,
        "patient_id": model.patient_id,
        "surface": model.surface_name,
        "frame": model.frame,
        "rr_s": model.timing.rr_s,
        "rr_assumed": model.timing.rr_assumed,
        "timing_assumed": model.timing.timing_assumed,
        "ed_phase": model.ed_phase,
        "es_fraction": model.es_fraction,
        "border_distance_mm": border_mm,
        "potential_at_border": potential_at_border(border_mm, 1.0),
        "unseen_share": model.unseen_share,
        "points": result.points,
        "excluded_area_share": result.excluded_area_share,
        "caps": plain(caps_of(surface.vertices_mm, surface.triangles, model.reference_caps[model.ed_phase])),
        "rim_mm": result.rim_mm,
        "seed": seed,
        "definitions": DEFINITIONS,
    }


def model_rows(
    model: "DvfModel",
    result: "ModelCheck",
    seconds: float | None,
    file_mb: float,
    anatomical: Mapping[str, Any] | None = None,
) -> list[tuple[str, str]]:
    """Build the rows of a model, with its anatomical error if labels gave it."""
    from dvf_ig.preop import border_distance_mm, potential_at_border

    border_mm = border_distance_mm(model)
    extent = (model.upper_mm - model.origin_mm).round(0).astype(int).tolist()
    return [
        ("model", f"{model.surface_name} of {model.patient_id}, frame {model.frame}"),
        ("phases", f"{model.phases}, RR {model.timing.rr_s:.3f} s, end-systole at {model.es_fraction:.2f}"),
        ("box", f"{extent[0]} x {extent[1]} x {extent[2]} mm, knots every {model.knot_spacing_mm:g} mm"),
        (
            "border",
            f"{border_mm:.1f} mm off the surface at the nearest: a sigmoid of 1/mm has fallen to "
            f"{potential_at_border(border_mm, 1.0):.0e} of its cap",
        ),
        ("chambers", ", ".join(chamber.name for chamber in model.chambers) or "none"),
        ("size", f"{file_mb:.1f} MB on disk; {model.megabytes:.1f} MB of {DEFINITIONS['megabytes']}"),
        (
            "spline fit error",
            f"{result.mean_mm:.3f} mm mean, {result.p99_mm:.3f} p99, {result.max_mm:.3f} max "
            f"({result.points} random points): {DEFINITIONS['surface_error_mm']}",
        ),
        *anatomical_rows(anatomical),
        (
            "normal error",
            f"{result.normal_median_deg:.2f}° median, {result.normal_p95_deg:.2f}° p95: "
            f"{DEFINITIONS['normal_error_deg']}",
        ),
        (
            "against facets",
            f"{result.facet_normal_median_deg:.2f}° median, {result.facet_normal_p95_deg:.2f}° p95: "
            f"{DEFINITIONS['normal_error_deg.facet']}",
        ),
        (
            "left out",
            f"{result.excluded_area_share:.0%} of the area: caps and {result.rim_mm:g} mm around them",
        ),
        *_seen_rows(model),
        ("time", f"{seconds:.1f} s" if seconds is not None else "-"),
    ]


def _seen_rows(model: "DvfModel") -> list[tuple[str, str]]:
    """Build the row of what no slice shows; none of a model of the whole heart."""
    seen = model.seen
    if seen is None:
        return []
    slabs = " and ".join(f"{low:.0f} to {high:.0f}" for low, high in seen.bounds_mm[model.ed_phase])
    return [
        (
            "not seen",
            f"{model.unseen_share:.0%} of the area: outside the slices, which show heights {slabs} mm along "
            f"{seen.normal.round(2).tolist()}; there no force is given, or one with the largest margin "
            "(margin: adaptive)",
        )
    ]


def anatomical_rows(error: Mapping[str, Any] | None) -> list[tuple[str, str]]:
    """Build the row of the error against labels; none without labels."""
    if error is None:
        return []
    return [
        (
            "anatomical error",
            f"{error['mean']:.3f} mm mean, {error['p95']:.3f} p95, over the {len(error['per_phase'])} phases "
            f"whose labels were not used: {DEFINITIONS['anatomical_error_mm']}",
        )
    ]


def phase_rows(model: "DvfModel", result: "ModelCheck") -> list[tuple[str, str]]:
    """Build one row a phase."""
    megabytes = model.megabytes / model.phases
    columns = zip(
        model.timing.fractions,
        result.per_phase_mm,
        result.per_phase_p99_mm,
        result.per_phase_normal_p95_deg,
        strict=True,
    )
    return [
        (
            f"phase {i}",
            f"at {fraction:.3f} RR: spline fit {mean:.4f} mm mean, {p99:.3f} p99; normal {turn:.2f}° p95; "
            f"{megabytes:.2f} MB",
        )
        for i, (fraction, mean, p99, turn) in enumerate(columns)
    ]
