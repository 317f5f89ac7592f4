"""`dvf-ig study gating`: R peaks and phase against annotated recordings."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, command, emit, output_dir, progress, wrote

if TYPE_CHECKING:
    from dvf_ig.study.gating.records import PhaseErrors, PhaseSummary, RecordGating

HEADER = (
    "record", "rhythm", "beats", "Se150", "PPV150", "Se50", "PPV50", "timing ms", "latency p95 ms",
    "x real time", "phase mean %", "p95 %", "valid %", "in 2σ %",
)  # fmt: skip


def gating(
    records: Annotated[
        Path, typer.Option("--records", help="Folder of WFDB records with annotations (.hea .dat .atr).")
    ],
    out: Annotated[
        Path | None,
        typer.Option(
            "-o", "--out", callback=output_dir, help="Write summary.json and risk_coverage.png here."
        ),
    ] = None,
    only: Annotated[str | None, typer.Option("--only", help="Records to use, separated by commas.")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Se, PPV, timing and phase error on annotated ECGs; phase by rhythm, tuning records apart."""
    with command(lists_inputs=False):
        from dvf_ig.io import files_together, output_folder, plain, write_json
        from dvf_ig.study.gating.summary import summarise_study

        names = _names(records, only)
        if out is None:
            scored = _score(records, names)
            summary = summarise_study(scored)
        else:
            with output_folder(out, ["summary.json", "risk_coverage.png"]) as folder:
                scored = _score(records, names)
                summary = summarise_study(scored)
                with files_together(folder) as new:
                    write_json(new / "summary.json", summary)
                    _draw(scored, new / "risk_coverage.png")
            wrote(out / "summary.json")
            wrote(out / "risk_coverage.png")
        if as_json:
            for record in summary["records"]:
                sys.stdout.write(json.dumps(plain(record), allow_nan=False) + "\n")
            return
        emit({}, _rows(summary), as_json=False)
        print("* the phase clock's limits were chosen on these records\n")
        emit({}, _phase_rows(summary), as_json=False)


def _names(folder: Path, only: str | None) -> list[str]:
    from dvf_ig.core import InvalidInputError

    found = sorted(path.stem for path in folder.glob("*.atr"))
    wanted = found if only is None else [name.strip() for name in only.split(",") if name.strip()]
    missing = [name for name in wanted if name not in found]
    if missing or not wanted:
        raise InvalidInputError(
            f"{folder} has no annotated record {', '.join(missing) or 'at all'}; "
            "needed NAME.hea, NAME.dat and NAME.atr in that folder"
        )
    return wanted


def _score(folder: Path, names: Sequence[str]) -> "list[RecordGating]":
    from dvf_ig.io import read_annotations, read_ecg
    from dvf_ig.study.gating.records import score_record

    scored = []
    with progress("records") as report:
        for k, name in enumerate(names):
            spec = f"wfdb:{folder / name}"
            scored.append(score_record(name, read_ecg(spec), read_annotations(spec)))
            report((k + 1) / len(names))
    return scored


def _rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [HEADER]
    for r in summary["records"]:
        rates = (f"{100 * r[k]:.2f}" for k in ("se_150", "ppv_150", "se_50", "ppv_50"))
        times = (f"{r['timing_ms']:.1f}", f"{r['latency_p95_ms']:.0f}", f"{r['speed']:.0f}")
        name = r["record"] + ("*" if r["tuning"] else "")
        rows.append((name, r["rhythm"], str(r["beats"]), *rates, *times, *_cells(r["phase"])))
    pooled = summary["beats"]
    rates = (f"{100 * pooled[k]:.2f}" for k in ("se_150", "ppv_150", "se_50", "ppv_50"))
    last = (
        f"{pooled['median_timing_ms']:.1f}",
        f"≤ {pooled['latency_p95_ms_max']:.0f}",
        f"≥ {pooled['slowest_x_real_time']:.0f}",
    )
    rows.append(("pooled", "", str(pooled["beats"]), *rates, *last))
    return rows


def _phase_rows(summary: dict[str, Any]) -> list[tuple[str, ...]]:
    rows: list[tuple[str, ...]] = [
        ("phase error, % RR", "mean", "p95", "valid %", "in 2σ %", "fibrillation refused %")
    ]
    for name, phase in summary["phase"].items():
        refused = phase.fibrillation_refused
        rows.append((name, *_cells(_fields(phase)), f"{100 * refused:.1f}" if refused == refused else ""))
    for name, error in summary["predictors"].items():
        mean, p95 = f"{error['mean_percent']:.2f}", f"{error['p95_percent']:.1f}"
        rows.append((f"predictor {name}", mean, p95, "all beats"))
    return rows


def _fields(phase: "PhaseSummary") -> dict[str, float]:
    from dataclasses import asdict

    return asdict(phase)


def _cells(phase: dict[str, float]) -> tuple[str, str, str, str]:
    mean, p95 = phase["mean_percent"], phase["p95_percent"]
    return (
        f"{mean:.2f}" if mean == mean else "–",
        f"{p95:.1f}" if p95 == p95 else "–",
        f"{100 * phase['valid_share']:.1f}",
        f"{100 * phase['within_2_sigma']:.1f}" if mean == mean else "–",
    )


def _draw(scored: "Sequence[RecordGating]", path: Path) -> None:
    from dvf_ig.report import write_png
    from dvf_ig.report.study.gating import RiskCoverage, risk_coverage_figure
    from dvf_ig.study.gating.records import RHYTHMS, pool, risk_coverage, summarise_phase

    classes: dict[str, PhaseErrors] = {}
    for rhythm in RHYTHMS:
        chosen = [r.errors for r in scored if r.rhythm == rhythm and not r.tuning]
        if chosen:
            classes[rhythm] = pool(chosen)
    if not classes:
        classes["all"] = pool([r.errors for r in scored])
    rhythms = []
    for name, errors in classes.items():
        share, p95, _ = risk_coverage(errors)
        now = summarise_phase([errors])
        rhythms.append(RiskCoverage(name, share, p95, now.valid_share, now.p95_percent))
    write_png(path, risk_coverage_figure(rhythms), dpi=130)
