"""`dvf-ig calibrate`: tool tip, image calibration, video lag and landmark registration from recordings."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .calibrate_output import DeviceSetOption, OutputOption, save, vector
from .calibrate_probe import probe
from .shell import JsonFlag, SeedOption, command, emit

if TYPE_CHECKING:
    from dvf_ig.calibration import LandmarkResult
    from dvf_ig.core import LatencyRecording

app = typer.Typer(help="Tool tip, image calibration, video lag, landmarks.", no_args_is_help=True)
app.command("probe")(probe)


@app.command("pivot")
def pivot(
    poses: Annotated[
        Path, typer.Argument(help="PLUS sequence, folder of 4x4 texts, or table x y z qx qy qz qw.")
    ],
    tool: Annotated[str | None, typer.Option("--tool", help="Frame of the tool in a sequence.")] = None,
    output: OutputOption = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Tool tip from poses recorded while the tip rested in a divot."""
    with command():
        import numpy as np

        from dvf_ig.calibration import calibrate_pivot
        from dvf_ig.io import read_poses

        found = calibrate_pivot(read_poses(poses, source=tool), rng=np.random.default_rng(seed))
        tip, divot = found.tip.xyz_mm[0].tolist(), found.pivot.xyz_mm[0].tolist()
        result = {
            "tip_mm": tip,
            "pivot_mm": divot,
            "rms_3d_mm": found.rms_3d_mm,
            "rms_per_coordinate_mm": found.rms_per_coordinate_mm,
            "inliers": int(found.inliers.sum()),
            "poses": found.poses,
            "span_deg": found.span_deg,
            "condition": found.condition,
            "tip_sd_mm": np.sqrt(np.diag(found.covariance)[:3]).tolist(),
            "tip_frame": found.tip.frame,
            "pivot_frame": found.pivot.frame,
        }
        matrix = np.eye(4)
        matrix[:3, 3] = tip
        name = f"{found.tip.frame}_from_{found.tip.frame}_tip"
        save(output, result, name, matrix, found.rms_3d_mm, [poses])
        rows = [
            ("tip", f"{vector(tip)} mm in '{found.tip.frame}'"),
            ("pivot", f"{vector(divot)} mm in '{found.pivot.frame}'"),
            (
                "residual",
                f"{found.rms_3d_mm:.3f} mm RMS (3-D), {found.rms_per_coordinate_mm:.3f} per coordinate",
            ),
            ("poses used", f"{int(found.inliers.sum())} of {found.poses}"),
            ("angular span", f"{found.span_deg:.1f} deg, condition {found.condition:.1f}"),
        ]
        emit(result, rows, as_json=as_json)


@app.command("latency")
def latency(
    tracker: Annotated[Path, typer.Argument(help="PLUS sequence with the tracked probe.")],
    video: Annotated[Path, typer.Argument(help="PLUS sequence of the water tank's floor.")],
    line_table: Annotated[
        Path | None,
        typer.Option("--line-table", help="PLUS line results; otherwise lines are found in the images."),
    ] = None,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="Write the result (JSON).")] = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Lag of the tracker's clock behind the video's: t_tracker = t_video + lag."""
    with command():
        from dvf_ig.calibration import estimate_latency

        found = estimate_latency(_latency_recording(tracker, video, line_table, seed))
        result = {
            "lag_s": found.lag_s,
            "interval_s": list(found.interval_s),
            "correlation": found.correlation,
            "second_lag_s": found.second_lag_s,
            "second_peak_ratio": found.second_peak_ratio,
            "halves_s": list(found.halves_s),
            "periods": found.periods,
        }
        inputs = [p for p in (tracker, video, line_table) if p is not None]
        save(output, result, None, None, None, inputs)
        low, high = (1000 * v for v in found.interval_s)
        side = "leads" if found.lag_s < 0 else "follows"
        rows = [
            ("lag", f"{1000 * found.lag_s:+.1f} ms (the tracker {side} the video)"),
            ("95 % interval", f"{low:+.1f} to {high:+.1f} ms"),
            ("halves", ", ".join(f"{1000 * v:+.1f}" for v in found.halves_s) + " ms"),
            ("correlation", f"{found.correlation:.3f}; next best {found.second_peak_ratio:.3f} of it"),
            ("movements", f"{found.periods:.1f}"),
        ]
        emit(result, rows, as_json=as_json)


@app.command("landmarks")
def landmarks(
    stylus: Annotated[
        Path, typer.Argument(help="PLUS sequence of a stylus resting on the landmarks in order.")
    ],
    device_set: DeviceSetOption,
    output: OutputOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Place a phantom by touching its landmarks, one after the other, in the order of the device set."""
    with command():
        found, dwells, names = _register_stylus(stylus, device_set)
        fitted = found.target_from_source
        result = {
            "target_from_source": fitted.matrix.tolist(),
            "rms_mm": found.rms_mm,
            "residuals_mm": found.residuals_mm.tolist(),
            "leave_one_out_mm": [v if v == v else None for v in found.leave_one_out_mm.tolist()],
            "landmarks": names,
            "target": fitted.target,
            "source": fitted.source,
        }
        save(output, result, fitted.name, fitted.matrix, found.rms_mm, [stylus, device_set])
        rows = [("transform", fitted.name), ("residual", f"{found.rms_mm:.3f} mm RMS")]
        for name, miss, samples in zip(names, found.residuals_mm, dwells, strict=True):
            rows.append((f"landmark {name}", f"{miss:.3f} mm, {samples} samples"))
        emit(result, rows, as_json=as_json)


def _latency_recording(tracker: Path, video: Path, line_table: Path | None, seed: int) -> "LatencyRecording":
    """From the line table, or with lines found in the video's images."""
    import numpy as np

    from dvf_ig.calibration import wall_trace
    from dvf_ig.core import InvalidInputError, LatencyRecording
    from dvf_ig.io import read_latency_recording, read_sequence

    if line_table is not None:
        return read_latency_recording(tracker, video, line_table)
    frames = read_sequence(video)
    if frames.images is None or not frames.has_timestamps:
        raise InvalidInputError(
            f"{video} has no {'images' if frames.images is None else 'time stamps'}; give the lines with "
            "--line-table, or a video with both"
        )
    rng = np.random.default_rng(seed)
    rows = wall_trace(frames.t_s, frames.images, frames.image_valid, rng=rng)
    return LatencyRecording(read_sequence(tracker).stream("tracker", "probe"), rows)


def _register_stylus(stylus: Path, device_set: Path) -> "tuple[LandmarkResult, list[int], list[str]]":
    """Registration, samples per landmark, names of the landmarks."""
    from dvf_ig.calibration import find_dwells, match_dwells, tip_positions
    from dvf_ig.core import InvalidInputError, Points
    from dvf_ig.io import read_coordinate_definitions, read_poses
    from dvf_ig.io.phantom_landmarks import read_phantom_landmarks

    poses = read_poses(stylus)
    name = f"{poses.source}_from_{poses.source}_tip"
    definitions = read_coordinate_definitions(device_set)
    if name not in definitions:
        raise InvalidInputError(
            f"{device_set} does not say where the tip of '{poses.source}' is; calibrate it first "
            "(dvf-ig calibrate pivot -o) and add the transform"
        )
    tip = Points(poses.source, definitions[name][None, :3, 3])
    phantom = read_phantom_landmarks(device_set)
    dwells = find_dwells(*tip_positions(poses, tip))
    found, chosen = match_dwells(dwells, phantom.points)
    return found, dwells.samples[list(chosen)].tolist(), list(phantom.names)
