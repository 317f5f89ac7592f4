"""`dvf-ig calibrate latency`: the lag between the tracker's clock and the video's."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from dvf_ig.cli.shell import JsonFlag, SeedOption, command, out_file, warn

from .output import judge, marked, save, show, verdict

if TYPE_CHECKING:
    from dvf_ig.calibration import LatencyResult
    from dvf_ig.core import LatencyRecording

WANDER_S = 0.015
"""Standard deviation of the lags of single movements above which the user is warned."""


def latency(
    tracker: Annotated[Path, Argument(help="PLUS sequence with the tracked probe.")],
    video: Annotated[Path, Argument(help="PLUS sequence of the water tank's floor.")],
    line_table: Annotated[
        Path | None, Option(help="PLUS line results; otherwise lines are found in the images.")
    ] = None,
    output: Annotated[Path | None, out_file("Write JSON here, and a picture next to it.")] = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Find the lag of the tracker's clock behind the video's: t_tracker = t_video + lag."""
    with command():
        from dvf_ig.calibration import estimate_latency
        from dvf_ig.report import write_latency_picture

        fit = estimate_latency(_recording(tracker, video, line_table, seed))
        result = _result(fit)
        title = marked(result, f"Tracker against video: {_lag_text(fit)}, r = {fit.correlation:.3f}")
        save(
            output, result, None, None, None,
            lambda png: write_latency_picture(png, fit, title=title),
        )  # fmt: skip
        show(result, _rows(fit), as_json=as_json)
        if fit.wander_s > WANDER_S:
            warn(
                f"single movements give lags that differ by {1000 * fit.wander_s:.0f} ms (SD): the clocks "
                "drift against one another, and the mean lag is wrong by as much at any time"
            )
        judge(result)


def _result(fit: "LatencyResult") -> dict[str, Any]:
    return {
        "kind": "latency",
        **verdict(fit.refusals),
        "lag_s": fit.lag_s,
        "interval_s": list(fit.interval_s),
        "correlation": fit.correlation,
        "second_lag_s": fit.second_lag_s if fit.second_peak_ratio else None,
        "second_peak_ratio": fit.second_peak_ratio,
        "second_sigmas": fit.second_sigmas if fit.second_peak_ratio else None,
        "halves_s": list(fit.halves_s),
        "periods": fit.periods,
        "period_lags_s": fit.period_lags_s.tolist(),
        "wander_s": fit.wander_s,
    }


def _lag_text(fit: "LatencyResult") -> str:
    low, high = (1000 * value for value in fit.interval_s)
    side = "leads" if fit.lag_s < 0 else "follows"
    return f"{1000 * fit.lag_s:+.1f} ms (95 %: {low:+.1f} to {high:+.1f}), the tracker {side} the video"


def _rows(fit: "LatencyResult") -> list[tuple[str, str]]:
    second = "no other lag comes near"
    if fit.second_peak_ratio:
        second = (
            f"next best {1000 * fit.second_lag_s:+.0f} ms at {fit.second_peak_ratio:.3f} of it, "
            f"{fit.second_sigmas:.1f} standard errors worse"
        )
    return [
        ("lag", _lag_text(fit)),
        ("halves", ", ".join(f"{1000 * v:+.1f}" for v in fit.halves_s) + " ms"),
        ("wander", f"{1000 * fit.wander_s:.1f} ms (SD of the lags of {len(fit.period_lags_s)} movements)"),
        ("correlation", f"{fit.correlation:.3f}; {second}"),
        ("movements", f"{fit.periods:.1f}"),
    ]


def _recording(tracker: Path, video: Path, line_table: Path | None, seed: int) -> "LatencyRecording":
    """Read the recording, with lines from the table or found in the video's images."""
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
