"""`dvf-ig calibrate landmarks`: place a phantom by touching its landmarks with a tracked stylus."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from dvf_ig.cli.shell import JsonFlag, command, warn

from .output import DeviceSetOption, OutputOption, judge, marked, save, show, vector, verdict

if TYPE_CHECKING:
    from dvf_ig.calibration import LandmarkResult, MapDifference, TipCheck
    from dvf_ig.core import Landmarks, Points, PoseStream

TIP_SHIFT_MM = 1.0
"""Distance of a stylus's pivot from its stated tip above which the user is warned."""


def landmarks(
    stylus: Annotated[Path, Argument(help="PLUS sequence of a stylus resting on the landmarks in order.")],
    device_set: DeviceSetOption,
    compare: Annotated[
        Path | None, Option(help="PLUS XML with another placement (default: the device set's).")
    ] = None,
    output: OutputOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Place a phantom by touching its landmarks, one after the other, in the order of the device set."""
    with command():
        from dvf_ig.calibration import check_tip, find_dwells, match_dwells, tip_positions
        from dvf_ig.io import read_phantom_landmarks, read_poses
        from dvf_ig.report import write_residual_picture

        poses, phantom = read_poses(stylus), read_phantom_landmarks(device_set)
        tip = _stated_tip(poses, device_set)
        dwells = find_dwells(*tip_positions(poses, tip))
        fit, chosen = match_dwells(dwells, phantom.points)
        difference = _difference(fit, phantom.points, compare, device_set)
        checked = check_tip(poses, tip, dwells)
        samples = dwells.samples[list(chosen)].tolist()
        result = _result(fit, phantom, samples, checked, difference)
        fitted = fit.target_from_source
        errors = f"{fit.rms_mm:.2f} mm RMS, {fit.mean_mm:.2f} mm mean"
        title = marked(result, f"{fitted.name}: {errors} over {len(samples)} landmarks")
        save(
            output, result, fitted.name, fitted.matrix, fit.rms_mm,
            lambda png: write_residual_picture(
                png, fit.residuals_mm, title=title, names=[f"landmark {n}" for n in phantom.names],
                second=fit.leave_one_out_mm,
            ),
        )  # fmt: skip
        rows = _rows(fit, phantom, samples, checked, difference)
        show(result, rows, as_json=as_json)
        _warn(fit, checked, poses.source)
        judge(result)


def _stated_tip(poses: "PoseStream", device_set: Path) -> "Points":
    from dvf_ig.core import InvalidInputError, Points
    from dvf_ig.io import read_coordinate_definitions

    name = f"{poses.source}_from_{poses.source}_tip"
    definitions = read_coordinate_definitions(device_set)
    if name not in definitions:
        raise InvalidInputError(
            f"{device_set} does not state the tip of '{poses.source}'; calibrate it first "
            "(dvf-ig calibrate pivot -o) and add the transform"
        )
    return Points(poses.source, definitions[name][None, :3, 3])


def _difference(
    fit: "LandmarkResult", points: "Points", compare: Path | None, device_set: Path
) -> "MapDifference | None":
    """Compare with the placement in the file to compare with, or in the device set if it has one."""
    from dvf_ig.calibration import map_difference
    from dvf_ig.core import InvalidInputError, Rigid
    from dvf_ig.io import read_coordinate_definitions

    fitted = fit.target_from_source
    matrix = read_coordinate_definitions(compare or device_set).get(fitted.name)
    if matrix is None:
        if compare is not None:
            raise InvalidInputError(f"{compare} has no transform {fitted.name} to compare with")
        return None
    return map_difference(fitted, Rigid.from_matrix(matrix, fitted.target, fitted.source), points)


def _result(
    fit: "LandmarkResult",
    phantom: "Landmarks",
    samples: list[int],
    checked: "TipCheck",
    difference: "MapDifference | None",
) -> dict[str, Any]:
    fitted = fit.target_from_source
    return {
        "kind": "landmarks",
        **verdict(fit.refusals),
        "target_from_source": fitted.matrix.tolist(),
        "rms_mm": fit.rms_mm,
        "mean_mm": fit.mean_mm,
        "residuals_mm": fit.residuals_mm.tolist(),
        "leave_one_out_mm": [v if v == v else None for v in fit.leave_one_out_mm.tolist()],
        "landmarks": list(phantom.names),
        "samples": samples,
        "ambiguous": fit.ambiguous,
        "second_rms_mm": fit.second_rms_mm if fit.second_rms_mm < float("inf") else None,
        "tip_shift_mm": checked.shift_mm.tolist(),
        "tip_spread_mm": [checked.spread_mm, checked.spread_after_mm],
        "difference": difference,
        "target": fitted.target,
        "source": fitted.source,
    }


def _rows(
    fit: "LandmarkResult",
    phantom: "Landmarks",
    samples: list[int],
    checked: "TipCheck",
    difference: "MapDifference | None",
) -> list[tuple[str, str]]:
    rows = [
        ("transform", fit.target_from_source.name),
        ("residual", f"{fit.rms_mm:.3f} mm RMS, {fit.mean_mm:.3f} mean, {max(fit.residuals_mm):.3f} max"),
    ]
    errors = zip(phantom.names, fit.residuals_mm, fit.leave_one_out_mm, samples, strict=True)
    for name, residual, without, count in errors:
        left_out = f", {without:.3f} left out" if without == without else ""
        rows.append((f"landmark {name}", f"{residual:.3f} mm{left_out}; {count} samples"))
    rows.append(("other order", f"{fit.second_rms_mm:.2f} mm RMS at best"))
    rows.append(
        (
            "stylus pivoted",
            f"about a point {vector(checked.shift_mm.tolist())} mm from its tip; spread "
            f"{checked.spread_mm:.2f} mm, {checked.spread_after_mm:.2f} about that point",
        )
    )
    if difference is not None:
        rows.append(
            (
                "difference",
                f"{difference.rotation_deg:.3f} deg, {difference.centroid_mm:.3f} mm at the centroid, "
                f"{difference.largest_mm:.3f} mm at most, from the stated placement",
            )
        )
    return rows


def _warn(fit: "LandmarkResult", checked: "TipCheck", tool: str) -> None:
    if fit.ambiguous:
        warn(
            f"the landmarks are nearly symmetric: in another order they fit to {fit.second_rms_mm:.2f} mm; "
            "make sure that they were touched in the device set's order"
        )
    shift = float((checked.shift_mm**2).sum() ** 0.5)
    if shift > TIP_SHIFT_MM:
        warn(
            f"in its divots '{tool}' pivoted about a point {shift:.1f} mm from its stated tip; calibrate the "
            "tip again (dvf-ig calibrate pivot)"
        )
