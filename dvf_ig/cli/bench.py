"""`dvf-ig bench`: how fast and how exact the fixture is, compared with other ways to the same distance."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from .shell import JsonFlag, SeedOption, ThreadsOption, command, emit, out_folder, progress, wrote

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel
    from dvf_ig.guidance import Continuity
    from dvf_ig.study.bench.calls import Bench, BenchOptions
    from dvf_ig.study.bench.servo import ServoBench, TickCost
    from dvf_ig.study.bench.session import SessionBench
    from dvf_ig.study.bench.timing import Row

Output = tuple[dict[str, Any], list[tuple[str, ...]]]
"""JSON values, and rows to print."""


def bench(
    model_file: Annotated[
        Path | None, Argument(metavar="[MODEL]", help="Model file (default: the phantom's heart).")
    ] = None,
    calls: Annotated[int, Option(min=100, help="Points of the path, 1 kHz.")] = 10_000,
    repeats: Annotated[int, Option(min=1, help="Passes; the fastest counts.")] = 5,
    peers: Annotated[bool, Option("--peers/--no-peers", help="Time other libraries too.")] = True,
    continuity: Annotated[
        int, Option(min=0, help="Also compare forces at this many pairs of neighbours.")
    ] = 0,
    session_s: Annotated[
        float | None,
        Option(
            "--session",
            metavar="SECONDS",
            help="Instead: a whole session of so many simulated seconds, on one core unless --threads.",
        ),
    ] = None,
    servo_s: Annotated[
        float | None,
        Option(
            "--servo",
            metavar="SECONDS",
            min=1.0,
            help="Instead: the lateness of each servo loop for so long, and what a tick costs.",
        ),
    ] = None,
    step_mm: Annotated[float, Option(help="Pitch of the phantom's mesh.")] = 1.5,
    out: Annotated[Path | None, out_folder("Folder for bench.json.")] = None,
    seed: SeedOption = 1,
    threads: ThreadsOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Time single calls, kernel loops and batches, ours and others', on one heart; print their ratios.

    Times are per call in µs, of the fastest pass; error_mm is the RMS error against the exact distance to
    the mesh. Other programs on the machine lengthen everything: compare ratios.
    """
    cores = threads or (1 if session_s is not None else 2)
    with command(threads if session_s is None and servo_s is None else cores):
        from dvf_ig.io import output_folder, provenance_fields, write_json

        if session_s is not None:
            result, rows = _bench_session(session_s, model_file, seed, cores)
        elif servo_s is not None:
            result, rows = _bench_servo(servo_s, _heart(model_file, step_mm, cores), seed)
        else:
            from dvf_ig.study.bench.calls import BenchOptions

            options = BenchOptions(calls, repeats, min(calls, 5000), peers, seed)
            result, rows = _bench_calls(_heart(model_file, step_mm, cores), options, continuity)
        if out is not None:
            with output_folder(out, ["bench.json"]):
                write_json(out / "bench.json", {**result, **provenance_fields()})
        emit(result, rows, as_json=as_json)
        if out is not None:
            wrote(out / "bench.json")


def _heart(model_file: Path | None, step_mm: float, threads: int) -> "DvfModel":
    """Read the model, or build the phantom's."""
    from dvf_ig.io import read_model
    from dvf_ig.study.bench.timing import bench_model

    if model_file is not None:
        return read_model(model_file)
    with progress("the phantom's heart") as report:
        return bench_model(step_mm=step_mm, threads=threads, progress=report)


def _bench_calls(model: "DvfModel", options: "BenchOptions", continuity: int) -> Output:
    from dvf_ig.io import plain
    from dvf_ig.study.bench.calls import continuity_checks, run_bench

    bench, checks = run_bench(model, options), continuity_checks(model, continuity, options.seed)
    result = {**plain(bench), "ratios": bench.ratios(), "continuity": plain(checks), "seed": options.seed}
    return result, [*_rows(bench), *_continuity_rows(checks)]


def _bench_session(seconds: float, model_file: Path | None, seed: int, threads: int) -> Output:
    from dvf_ig.io import plain, read_model
    from dvf_ig.study.bench.session import bench_scenario, bench_setup, round_of, run_session

    with progress("a synthetic intervention") as report:
        scenario = bench_scenario(seed, report)
    with progress("its heart") as report:
        built = None if model_file is None else read_model(model_file)
        setup = bench_setup(scenario, seed, built, report)
    with progress("the session") as report:
        timed = run_session(setup, round_of(scenario), seconds, report)
    factors = {"real_time_factor": timed.real_time_factor, "growth_percent": timed.growth_percent}
    return {**plain(timed), **factors, "seed": seed, "threads": threads}, _session_rows(timed)


def _bench_servo(seconds: float, model: "DvfModel", seed: int) -> Output:
    from dvf_ig.io import plain
    from dvf_ig.study.bench.servo import bench_servo, bench_tick

    cost = bench_tick(model, seed)
    with progress("the servo loops") as report:
        timed = bench_servo(model, seconds, seed, report)
    result = {**plain(timed), "rows": plain((*timed.rows, *cost.rows)), "ratios": cost.ratios, "seed": seed}
    return result, _servo_rows(timed, cost)


def _servo_rows(done: "ServoBench", cost: "TickCost") -> list[tuple[str, ...]]:
    rows = _timing_rows((*done.rows, *cost.rows))
    rows += [("ratio", name, f"{ratio:9.2f}") for name, ratio in cost.ratios.items()]
    rows.append(("", "p99, Python thread / servo at 1 kHz", f"{done.python_p99_ratio:9.0f}"))
    rows.append(("", "real-time priority", "yes" if done.realtime else "no"))
    return rows


def _session_rows(done: "SessionBench") -> list[tuple[str, ...]]:
    growth = done.growth_percent
    rows = [
        *_timing_rows(done.rows),
        ("session", "real-time factor", f"{done.real_time_factor:9.2f}"),
        ("", "computing, s", f"{done.computing_s:9.1f}"),
        ("", "force may be used, %", f"{100 * done.served_share:9.1f}"),
    ]
    if growth is not None:
        rows.append(("memory", "after warm-up, MB", f"{done.resident_mb_start:9.1f}"))
        rows.append(("", "growth, %", f"{growth:9.2f}"))
    return rows


def _timing_rows(timed: "Sequence[Row]") -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [("", "", "median µs", "p99", "p99.9", "max", "error mm", "")]
    for r in timed:
        times = [f"{t:9.3f}" for t in (r.median_us, r.p99_us, r.p999_us, r.max_us)]
        rows.append((r.name, r.what, *times, "" if r.error_mm is None else f"{r.error_mm:.4f}", r.note))
    return rows


def _rows(done: "Bench") -> list[tuple[str, ...]]:
    rows = _timing_rows(done.rows)
    rows += [("ratio", name, f"{ratio:9.2f}") for name, ratio in done.ratios().items()]
    rows.append(("first call", "new process, s", f"{done.first_call_s:9.3f}"))
    size = f"{done.vertices} vertices, {done.phases} phases, {done.megabytes:.1f} MB"
    rows.append(("heart", size, "", "", "", "", f"{done.near_error_mm:.4f}", "our error within 2 mm of it"))
    return rows


def _continuity_rows(checks: "list[Continuity]") -> list[tuple[str, ...]]:
    if not checks:
        return []
    rows: list[tuple[str, ...]] = [
        ("", "", "of bound", "pairs", "across switches", "|∇d| < 0.4", "beyond the bound")
    ]
    rows += [
        (
            "continuity",
            f"{c.blend}, {c.law}",
            f"{c.largest_share:9.3f}",
            f"{c.pairs}",
            f"{c.across_switches}",
            f"{c.near_no_direction}",
            f"{c.violations}",
        )
        for c in checks
    ]
    return rows
