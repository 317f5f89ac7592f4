"""`dvf-ig calibrate probe --phantom nwire`: every method on an N-wire sweep, and the chosen one."""

from dataclasses import dataclass, replace
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any, Literal

from dvf_ig.cli.shell import progress, wrote

from . import output

if TYPE_CHECKING:
    from dvf_ig.calibration import CalibrationErrors, WireImageOptions, WireSegmentation
    from dvf_ig.calibration.probe.nwire import NWireResult, NWireVariants
    from dvf_ig.core import NWireRecording, WireSearch
    from dvf_ig.io import ProbeNames


@dataclass(frozen=True, slots=True, eq=False)
class WireRecording:
    """Recording with the segmentation of its wires, which is None if a table gave them."""

    recording: "NWireRecording"
    segmentation: "WireSegmentation | None"


def read_wires(
    sequence: Path,
    device_set: Path,
    table: Path | None,
    section: Literal["CalibrationData", "ValidationData"],
    names: "ProbeNames",
    picture: Path | None = None,
) -> WireRecording:
    """Read wires from a section of a PLUS result, or find them in the images without a table.

    Args:
        names: names of the probe and its reference in the sequence.
        picture: PNG of the detections in the images, also written if there are not enough.
    """
    from dvf_ig.calibration import recording_of, segment_wires
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io import phantom_from_probe, read_nwire_phantom, read_nwire_recording, read_wire_search
    from dvf_ig.io.plus.sequence_read import read_sequence
    from dvf_ig.report import write_wire_picture

    if table is not None:
        if picture is not None:
            raise InvalidInputError("--picture shows wires found in images; leave out --points to find them")
        return WireRecording(read_nwire_recording(sequence, device_set, table, section, names), None)
    phantom = read_nwire_phantom(device_set)
    recorded = read_sequence(sequence)
    poses = phantom_from_probe(sequence, recorded, device_set, names)
    options = wire_image_options(read_wire_search(device_set))
    with progress("images") as report:
        segmented = segment_wires(recorded, phantom, options=options, progress=report)
    if picture is not None:
        title = f"{sequence.name}: wires found in {segmented.used} of {len(segmented.frames)} frames"
        write_wire_picture(picture, recorded, segmented, title=title)
        wrote(picture, "image")
    return WireRecording(recording_of(segmented, phantom, poses), segmented)


def wire_image_options(search: "WireSearch") -> "WireImageOptions":
    """Read the settings of the search from a device set; missing ones keep their default."""
    from dvf_ig.calibration import WireImageOptions

    options = WireImageOptions()
    if search.candidates is not None:
        # more cost little, and a bright wall can take many of them
        options = replace(options, most=max(options.most, search.candidates))
    if search.collinear_mm is not None:
        tolerances = replace(options.tolerances, collinear_mm=search.collinear_mm)
        options = replace(options, tolerances=tolerances)
    return replace(options, spacing_mm=search.spacing_mm, clip=search.clip)


def segmentation_json(seen: WireRecording | None) -> dict[str, Any] | None:
    """Count frames used and left out by reason; None if a table gave the wires."""
    if seen is None or seen.segmentation is None:
        return None
    segmented = seen.segmentation
    return {"frames_used": segmented.used, "frames": len(segmented.frames), "reasons": segmented.reasons}


def segmentation_rows(seen: WireRecording, validated: WireRecording | None) -> list[tuple[str, str]]:
    """Build rows of the share of frames used, and the number left out by reason."""
    rows = []
    for what, wires in (("calibration", seen), ("validation", validated)):
        if wires is None or wires.segmentation is None:
            continue
        used, frames = wires.segmentation.used, len(wires.segmentation.frames)
        rows.append((f"{what} wires", f"found in {used} of {frames} frames ({100 * used / frames:.0f} %)"))
        rows += [("left out", f"{n} frames: {why}") for why, n in wires.segmentation.reasons.items()]
    return rows


def nwire_result(
    sequence: Path,
    device_set: Path | None,
    validate: Path | None,
    tables: tuple[Path | None, Path | None],
    names: "ProbeNames",
    method: str | None,
    picture: Path | None,
    max_residual_mm: float | None,
    rng: Any,
) -> output.ProbeCalibration:
    """Calibrate from an N-wire sweep.

    Args:
        tables: PLUS results with the wire points of the calibration and of the validation sequence; None
            finds the wires in the images.
        names: names of the probe and its reference in the sequences.
    """
    from dvf_ig.calibration import NWireOptions, compare_nwire_methods, validate_nwire
    from dvf_ig.core import InvalidInputError

    if device_set is None:
        raise InvalidInputError("an N-wire phantom needs --device-set XML with its wires and its placement")
    seen = read_wires(sequence, device_set, tables[0], "CalibrationData", names, picture)
    validated = None
    if validate is not None:
        validated = read_wires(validate, device_set, tables[1], "ValidationData", names)
    recording, held_out = seen.recording, None if validated is None else validated.recording
    options = NWireOptions()
    if max_residual_mm is not None:
        options = NWireOptions(max_mean_mm=max_residual_mm)
    variants = compare_nwire_methods(recording, rng=rng, options=options)
    fit = _chosen(variants, method)
    checked = {
        name: None if held_out is None else validate_nwire(r.probe_from_image, held_out)
        for name, r in variants.results.items()
    }
    result = _result(fit, checked[fit.method], recording, max_residual_mm)
    result["max_residual_mm"] = options.max_mean_mm
    result["method_from"] = "cross-validation of the calibration frames" if method is None else "--method"
    result["variants"] = _variants(variants, checked)
    result["segmentation"] = segmentation_json(seen)
    result["validation_segmentation"] = segmentation_json(validated)
    rows: list[tuple[str, ...]] = [*segmentation_rows(seen, validated)]
    rows += [*_rows(fit, checked[fit.method], result["turned_deg"]), *_variant_rows(result)]
    error_mm = (checked[fit.method] or fit.calibration).summary.mean95
    return output.ProbeCalibration(result, rows, error_mm, fit)


def _chosen(variants: "NWireVariants", method: str | None) -> "NWireResult":
    from dvf_ig.calibration import NWIRE_METHODS
    from dvf_ig.core import InvalidInputError, QualityGateError

    if method is None:
        return variants.best
    for name in NWIRE_METHODS:
        if name == method:
            if name in variants.failed:
                raise QualityGateError(f"method {name}: {variants.failed[name]}")
            return variants.results[name]
    raise InvalidInputError(f"probe method '{method}' is unknown; choose {', '.join(NWIRE_METHODS)}")


def _result(
    fit: "NWireResult",
    checked: "CalibrationErrors | None",
    recording: "NWireRecording",
    max_residual_mm: float | None,
) -> dict[str, Any]:
    from dvf_ig.calibration.pivot.pivot import rotation_span_deg
    from dvf_ig.calibration.probe.errors import KNOWN_POINT_MM, known_points_refusals

    turned_deg = rotation_span_deg(recording.phantom_from_probe.rotations[fit.inliers])
    limit_mm = KNOWN_POINT_MM if max_residual_mm is None else max_residual_mm
    refusals = fit.refusals
    if checked is not None:
        refusals += known_points_refusals(
            checked, own=fit.calibration, turned_deg=turned_deg, limit_mm=limit_mm
        )
    return {
        "kind": "probe",
        **output.verdict(refusals),
        **output.image_fields(fit.probe_from_image),
        "phantom": "nwire",
        "calibration": output.error_fields(fit.calibration),
        "validation": output.error_fields(checked),
        "method": fit.method,
        "inlier_frames": int(fit.inliers.sum()),
        "turned_deg": turned_deg,
        "rejected": output.rejected_list(fit.rejected),
        "edge_sd_mm": fit.edge_sd_mm,
        "shear_deg": fit.shear_deg,
        "leave_one_out_rms_mm": float((fit.uncertainty.held_out_mm**2).mean() ** 0.5),
        "uncertainty": output.uncertainty(fit.uncertainty),
    }


def _variants(
    variants: "NWireVariants", checked: "dict[Any, CalibrationErrors | None]"
) -> dict[str, dict[str, Any]]:
    from dvf_ig.calibration import NWIRE_METHODS

    table: dict[str, dict[str, Any]] = {}
    for name in NWIRE_METHODS:
        if name in variants.failed:
            table[name] = {"refused": variants.failed[name]}
            continue
        errors = checked[name]
        table[name] = {
            "calibration": output.error_fields(variants.results[name].calibration),
            "validation": output.error_fields(errors),
            "cross_validated_mean95_mm": variants.cross_validated_mm[name],
            "in_plane_mm": fmean((errors or variants.results[name].calibration).in_plane_mm.values()),
        }
        if variants.results[name].refusals:
            table[name]["refused"] = "; ".join(why.detail for why in variants.results[name].refusals)
    return table


def _rows(
    fit: "NWireResult", checked: "CalibrationErrors | None", turned_deg: float
) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("frames used", f"{int(fit.inliers.sum())} of {fit.calibration.frames}"),
        ("probe turned", f"{turned_deg:.1f} deg at most between two frames"),
        *output.map_rows(fit.uncertainty),
        ("calibration", output.error_row(fit.calibration)),
    ]
    if checked is not None:
        rows.append(("validation", output.error_row(checked)))
    rows += output.rejected_rows(fit.rejected)
    return rows + list(output.wire_rows(checked or fit.calibration))


def _variant_rows(result: dict[str, Any]) -> list[tuple[str, ...]]:
    """Tabulate the methods: lowest 95 % of the errors, in mm."""
    rows: list[tuple[str, ...]] = [
        ("method", "cross-validated  calibration  validation  in plane (mm; all but the last: lowest 95 %)")
    ]
    for name, entry in result["variants"].items():
        used = " *" if name == result["method"] else ""
        if "refused" in entry:
            rows.append((name, entry["refused"]))
            continue
        checked = entry["validation"]
        held_out = "-" if checked is None else f"{checked['mean95_mm']:.3f}"
        crossed, fitted = entry["cross_validated_mean95_mm"], entry["calibration"]["mean95_mm"]
        rows.append(
            (name + used, f"{crossed:<15.3f}  {fitted:<11.3f}  {held_out:<10}  {entry['in_plane_mm']:.3f}")
        )
    return [*rows, ("* used", f"chosen by {result['method_from']}")]
