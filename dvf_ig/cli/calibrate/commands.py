"""`dvf-ig calibrate`: the tool tip and the video lag here, the other calibrations from their own modules."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, command, emit, warn

from .hand_eye import hand_eye
from .landmarks import landmarks
from .output import OutputOption, save, vector
from .probe import probe

if TYPE_CHECKING:
    from dvf_ig.calibration import LatencyResult
    from dvf_ig.core import LatencyRecording

WANDER_S = 0.015
"""Standard deviation of the lags of single movements beyond which the user is told."""

app = typer.Typer(help="Tool tip, image calibration, video lag, landmarks, hand-eye.", no_args_is_help=True)
app.command("probe")(probe)
app.command("landmarks")(landmarks)
app.command("hand-eye")(hand_eye)


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
        from dvf_ig.io import read_poses, write_residual_picture

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
        title = (
            f"Tool tip of '{found.tip.frame}': {found.rms_3d_mm:.2f} mm RMS over {int(found.inliers.sum())} "
            f"of {found.poses} poses that span {found.span_deg:.0f}°"
        )
        save(
            output, result, name, matrix, found.rms_3d_mm, [poses],
            lambda png: write_residual_picture(png, found.residuals_mm, title=title, used=found.inliers),
        )  # fmt: skip
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
    output: Annotated[
        Path | None, typer.Option("-o", "--out", help="Write JSON here, and a picture beside it.")
    ] = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Lag of the tracker's clock behind the video's: t_tracker = t_video + lag."""
    with command():
        from dvf_ig.calibration import estimate_latency
        from dvf_ig.io import write_latency_picture

        found = estimate_latency(_latency_recording(tracker, video, line_table, seed))
        result = {
            "lag_s": found.lag_s,
            "interval_s": list(found.interval_s),
            "correlation": found.correlation,
            "second_lag_s": found.second_lag_s if found.second_peak_ratio else None,
            "second_peak_ratio": found.second_peak_ratio,
            "second_sigmas": found.second_sigmas if found.second_peak_ratio else None,
            "halves_s": list(found.halves_s),
            "periods": found.periods,
            "period_lags_s": found.period_lags_s.tolist(),
            "wander_s": found.wander_s,
        }
        inputs = [p for p in (tracker, video, line_table) if p is not None]
        title = f"Tracker against video: {_lag_text(found)}, r = {found.correlation:.3f}"
        save(
            output, result, None, None, None, inputs,
            lambda png: write_latency_picture(png, found, title=title),
        )  # fmt: skip
        emit(result, _latency_rows(found), as_json=as_json)
        if found.wander_s > WANDER_S:
            warn(
                f"single movements give lags that differ by {1000 * found.wander_s:.0f} ms (SD): the clocks "
                "drift against one another, and the mean lag is off by as much at any one moment"
            )


def _lag_text(found: "LatencyResult") -> str:
    low, high = (1000 * value for value in found.interval_s)
    side = "leads" if found.lag_s < 0 else "follows"
    return f"{1000 * found.lag_s:+.1f} ms (95 %: {low:+.1f} to {high:+.1f}), the tracker {side} the video"


def _latency_rows(found: "LatencyResult") -> list[tuple[str, str]]:
    second = "no other lag comes near"
    if found.second_peak_ratio:
        second = (
            f"next best {1000 * found.second_lag_s:+.0f} ms at {found.second_peak_ratio:.3f} of it, "
            f"{found.second_sigmas:.1f} standard errors worse"
        )
    return [
        ("lag", _lag_text(found)),
        ("halves", ", ".join(f"{1000 * v:+.1f}" for v in found.halves_s) + " ms"),
        (
            "wander",
            f"{1000 * found.wander_s:.1f} ms (SD of the lags of {len(found.period_lags_s)} movements)",
        ),
        ("correlation", f"{found.correlation:.3f}; {second}"),
        ("movements", f"{found.periods:.1f}"),
    ]


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
