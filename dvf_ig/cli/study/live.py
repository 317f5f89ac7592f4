"""`dvf-ig study live`: the same scenario through a live session and through a replay."""

from pathlib import Path
from typing import Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, SeedOption, ThreadsOption, command, emit, output_dir, progress, wrote


def live(
    scenario: Annotated[Path, typer.Argument(help="Scenario folder (see `dvf-ig synth scenario`).")],
    out: Annotated[
        Path | None, typer.Option("-o", "--out", callback=output_dir, help="Folder for live.json.")
    ] = None,
    cut_s: Annotated[
        float | None,
        typer.Option("--cut", min=1.0, help="Cut the connection after so long, within a message."),
    ] = None,
    as_json: JsonFlag = False,
    seed: SeedOption = 0,
    threads: ThreadsOption = None,
) -> None:
    """Stream a scenario over loopback at real speed to a live session, and replay it; say what differs.

    Registrations, states, error at the targets, force after the latency is taken off, and the latency from a
    tool pose's arrival to the force's departure. Takes the recording's length and a replay; on a machine that
    does something else besides, the live session sees the difference.
    """
    with command(threads):
        from dvf_ig.intake import cached_model, read_scenario
        from dvf_ig.io import output_folder, write_json
        from dvf_ig.replay import run_replay
        from dvf_ig.replay.start import landmarks_start
        from dvf_ig.study.live.compare import after_cut, comparison
        from dvf_ig.study.live.run import run_live

        recorded = read_scenario(scenario)
        with progress("replay") as report:
            model = cached_model(recorded.preop).model
            replayed = run_replay(recorded, model=model, seed=seed, progress=report)
        landmarks = None
        if landmarks_start(recorded) and recorded.landmarks_mr and recorded.landmarks_tracker:
            landmarks = (recorded.landmarks_mr, recorded.landmarks_tracker)
        run = run_live(scenario, replayed.setup, landmarks, cut_s)
        result = comparison(run, replayed, recorded.truth)
        if cut_s is not None:
            result["cut"] = after_cut(run, replayed, cut_s)
        if out is not None:
            with output_folder(out, ["live.json"]):
                write_json(out / "live.json", result)
        emit(result, _rows(result), as_json=as_json)
        if out is not None:
            wrote(out / "live.json")


def _rows(result: dict[str, Any]) -> list[tuple[str, ...]]:
    latency = result["latency_ms"]
    rows: list[tuple[str, ...]] = [
        ("latency, pose in to force out", "median {median:.2f} ms, p99 {p99:.2f} ms".format(**latency)),
        ("same status", f"{100 * result['same_status_share']:.1f} % of answers"),
        ("same supervisor state", f"{100 * result['same_supervisor_share']:.1f} % of answers"),
    ]
    for name, what in (("force_session", "session's force"), ("force_servo", "servo's force")):
        force = result[name]
        if force["answers"]:
            line = "apart by median {median_n:.4f} N, p95 {p95_n:.4f}, max {max_n:.3f}".format(**force)
            after = "after {shift_ms:.1f} ms".format(**force) if "shift_ms" in force else ""
            rows.append((what, line, after))
    for key, what in (("pose_in_time", "tool's pose in time"), ("pose_late", "tool's pose late")):
        force = result["force_session"].get(key, {"answers": 0})
        if force["answers"]:
            line = "{answers} answers, p95 {p95_n:.4f} N, max {max_n:.3f}".format(**force)
            rows.append((f"session's force, {what}", line))
    if "tre_mm" in result:
        tre = result["tre_mm"]
        means = f"live {tre['live']['mean']:.3f} mm, replay {tre['replay']['mean']:.3f} mm"
        rows.append(("mean error at the targets", means))
    if "cut" in result:
        cut = result["cut"]
        times = ", ".join(
            f"{what} after {cut[key]:.2f} s"
            for key, what in (("fading_s", "fades"), ("back_s", "comes back"), ("phase_s", "with its phase"))
            if cut[key] is not None
        )
        rows.append(
            (f"force after the cut at {cut['cut_s']:g} s", times, "re-armed" if cut["latched"] else "")
        )
    for number, row in enumerate(result["registrations"], start=1):
        ours, theirs = row["live"], row["replay"]
        both = " / ".join(
            "none" if one is None else f"asked {one['asked_s']:.2f} s, known {one['ready_s']:.2f} s"
            for one in (ours, theirs)
        )
        apart = "" if row["apart_mm"] is None else f"{row['apart_mm']:.3f} mm apart"
        rows.append((f"registration {number}, live / replay", both, apart))
    return rows
