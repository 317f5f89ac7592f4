"""`dvf-ig calibrate latency`: the lag between the tracker's clock and the video's."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, command, output_file, warn

from .output import judge, marked, save, show, verdict

if TYPE_CHECKING:
    from dvf_ig.calibration import LatencyResult
    from dvf_ig.core import LatencyRecording

WANDER_S = 0.015
"""Standard deviation of the lags of single movements beyond which the user is warned."""


def latency(
    tracker: Annotated[Path, typer.Argument(help="PLUS sequence with the tracked probe.")],
    video: Annotated[Path, typer.Argument(help="PLUS sequence of the water tank's floor.")],
    line_table: Annotated[
        Path | None,
        typer.Option("--line-table", help="PLUS line results; otherwise lines are found in the images."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--out", callback=output_file, help="Write JSON here, and a picture beside it."),
    ] = None,
    seed: SeedOption = 0,
    as_json: JsonFlag = False,
) -> None:
    """Lag of the tracker's clock behind the video's: t_tracker = t_video + lag."""
    with command():
        from dvf_ig.calibration import estimate_latency
        from dvf_ig.report import write_latency_picture

        found = estimate_latency(_recording(tracker, video, line_table, seed))
        result = _result(found)
        title = marked(result, f"Tracker against video: {_lag_text(found)}, r = {found.correlation:.3f}")
        save(
            output, result, None, None, None,
            lambda png: write_latency_picture(png, found, title=title),
        )  # fmt: skip
        show(result, _rows(found), as_json=as_json)
        if found.wander_s > WANDER_S:
            warn(
                f"single movements give lags that differ by {1000 * found.wander_s:.0f} ms (SD): the clocks "
                "drift against one another, and the mean lag is off by as much at any one moment"
            )
        judge(result)


def _result(found: "LatencyResult") -> dict[str, Any]:
    return {
        "kind": "latency",
        **verdict(found.refusals),
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


def _lag_text(found: "LatencyResult") -> str:
    low, high = (1000 * value for value in found.interval_s)
    side = "leads" if found.lag_s < 0 else "follows"
    return f"{1000 * found.lag_s:+.1f} ms (95 %: {low:+.1f} to {high:+.1f}), the tracker {side} the video"


def _rows(found: "LatencyResult") -> list[tuple[str, str]]:
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


def _recording(tracker: Path, video: Path, line_table: Path | None, seed: int) -> "LatencyRecording":
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
