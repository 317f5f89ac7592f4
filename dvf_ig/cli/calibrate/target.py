"""`dvf-ig calibrate probe --phantom cross-wire|wall`: one fixed point, or one flat wall."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import output

if TYPE_CHECKING:
    from dvf_ig.calibration import CalibrationErrors, TargetResult
    from dvf_ig.core import FloatArray, PoseStream
    from dvf_ig.io import ProbeNames

METHODS = ("orthogonal", "isotropic")


def target_result(
    phantom: str,
    recorded: tuple[Path, Path | None],
    validate: tuple[Path | None, Path | None],
    names: "ProbeNames",
    method: str | None,
    max_residual_mm: float | None,
    rng: Any,
) -> output.ProbeCalibration:
    """Calibrate from a fixed target: JSON, rows to print and the error to save.

    Args:
        recorded, validate: file of the poses (and images), and table of the points.
        names: names of the probe and its reference in the poses.
    """
    from dvf_ig.calibration import TargetOptions
    from dvf_ig.core import InvalidInputError

    if method not in (None, *METHODS):
        raise InvalidInputError(f"a {phantom} has no method '{method}'; choose {' or '.join(METHODS)}")
    options = TargetOptions(isotropic=method == "isotropic")
    if max_residual_mm is not None:
        options = replace(options, max_rms_mm=max_residual_mm)
    seen = _recording(phantom, *recorded, names, "--points", rng)
    second = None
    if validate[0] is not None:
        second = _recording(phantom, validate[0], validate[1], names, "--validate-points", rng)
    solve = _crosswire if phantom == "cross-wire" else _wall
    fit, checked, place, rows = solve(seen, second, options, rng)
    result = {
        "kind": "probe",
        **output.verdict(fit.refusals),
        "max_residual_mm": options.max_rms_mm,
        **output.image_fields(fit.probe_from_image),
        "phantom": phantom,
        "calibration": output.error_fields(fit.calibration),
        "validation": output.error_fields(checked),
        "method": method or METHODS[0],
        "inlier_frames": int(fit.inliers.sum()),
        "rejected": output.rejected_list(fit.rejected),
        "leave_one_out": output.error_fields(fit.held_out),
        **place,
        "uncertainty": output.uncertainty(fit.uncertainty),
    }
    table: list[tuple[str, ...]] = [
        ("frames used", f"{int(fit.inliers.sum())} of {fit.calibration.frames}"),
        *output.map_rows(fit.uncertainty),
        *rows,
        ("calibration", output.error_row(fit.calibration)),
        ("leave-one-out", output.error_row(fit.held_out)),
    ]
    if checked is not None:
        table.append(("validation", output.error_row(checked)))
    table += output.rejected_rows(fit.rejected)
    return output.ProbeCalibration(result, table, (checked or fit.held_out).summary.mean95, fit)


Solved = tuple[
    "TargetResult[Any]", "CalibrationErrors | None", dict[str, Any], list[tuple[str, ...]]
]  # fmt: skip
PosesAndPoints = tuple["PoseStream", "FloatArray"]


def _crosswire(seen: PosesAndPoints, second: PosesAndPoints | None, options: Any, rng: Any) -> Solved:
    from dvf_ig.calibration import calibrate_crosswire, validate_crosswire

    fit = calibrate_crosswire(*seen, rng=rng, options=options)
    checked = None if second is None else validate_crosswire(fit.probe_from_image, *second)[0]
    crossing, frame = fit.target.xyz_mm.tolist(), seen[0].target
    place = {"crossing_mm": crossing, "target_frame": frame}
    return fit, checked, place, [("crossing", f"{output.vector(crossing)} mm in '{frame}'")]


def _wall(seen: PosesAndPoints, second: PosesAndPoints | None, options: Any, rng: Any) -> Solved:
    from dvf_ig.calibration import calibrate_wall, validate_wall

    fit = calibrate_wall(*seen, rng=rng, options=options)
    checked = None if second is None else validate_wall(fit.probe_from_image, *second)[0]
    plane, frame = fit.target, seen[0].target
    place = {"wall_normal": plane.normal.tolist(), "wall_offset_mm": plane.offset_mm, "target_frame": frame}
    shown = f"{output.vector(plane.normal.tolist())} · x = {plane.offset_mm:.3f} mm in '{frame}'"
    return fit, checked, place, [("wall", shown)]


def _recording(
    phantom: str, sequence: Path, points: Path | None, names: "ProbeNames", option: str, rng: Any
) -> PosesAndPoints:
    """Read poses and points; without points, a wall's line is searched in the images."""
    from dvf_ig.calibration import find_wall_lines
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io import read_sequence, read_target_recording, tracked_probe

    if points is not None:
        return read_target_recording(sequence, points, names)
    frames = read_sequence(sequence)
    if phantom != "wall" or frames.images is None:
        what = "the crossing is not detected in images" if phantom != "wall" else "it has no images"
        raise InvalidInputError(
            f"{sequence}: {what}; give {option} FILE, a table of the columns frame, column1_px, row1_px"
            + (", column2_px, row2_px" if phantom == "wall" else "")
        )
    return tracked_probe(frames, names), find_wall_lines(frames.images, rng=rng).end_points_px(
        frames.image_valid
    )
