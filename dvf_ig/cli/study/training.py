"""`dvf-ig study training`: gradient descent (eq. 3), conjugate gradients and exact least squares."""

from typing import Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, command, emit, progress, warn, whole_numbers, wrote

from .options import FirstSeedOption, FolderOption, SeedsOption

DEGREES = "1,2,3"
PITCH_MM = 8.0
MAX_ITERATIONS = 3000


def training(
    out: FolderOption,
    degrees: Annotated[str, typer.Option("--degrees", help="Degrees of the B-splines, 1 to 5.")] = DEGREES,
    seeds: SeedsOption = 1,
    seed: FirstSeedOption = 1,
    as_json: JsonFlag = False,
) -> None:
    """Convergence and time of three ways to fit a phantom heart's distances, by degree of the splines."""
    with command(lists_inputs=False):
        from dvf_ig.io import files_together, output_folder, write_json
        from dvf_ig.io.writing.atomic import write_bytes
        from dvf_ig.report.study.training import training_png
        from dvf_ig.study.training.comparison import curves_of, summarise_training, training_trial
        from dvf_ig.study.trials import Study, run_trials

        settings = {
            "degrees": list(whole_numbers(degrees, "--degrees", DEGREES)),
            "pitch_mm": PITCH_MM,
            "max_iterations": MAX_ITERATIONS,
        }
        with output_folder(out, ["summary.json", "training.png"]), progress("training") as report:
            # one process: trials side by side would disturb each other's times
            lines = run_trials(
                Study("training", settings, training_trial), range(seed, seed + seeds), out, progress=report
            )
            rows = summarise_training(lines)
            refused = [line for line in lines if "refused" in line]
            summary = {**settings, "seed": seed, "seeds": seeds, "refused": len(refused), "rows": rows}
            drawn = next((line for line in lines if "refused" not in line), None)
            with files_together(out, ("summary.json", "training.png")) as new:
                write_json(new / "summary.json", summary)
                if drawn is not None:
                    title = (
                        f"Training on the distances of phantom {drawn['seed']}, knots every {PITCH_MM:g} mm"
                    )
                    write_bytes(new / "training.png", training_png(curves_of(drawn), title))
        if refused:
            warn(f"{len(refused)} of {seeds} trials were refused; the first: {refused[0]['refused']}")
        emit(summary, _rows(rows), as_json=as_json)
        for name in ("study.json", "trials.jsonl", "summary.json", *(["training.png"] if drawn else [])):
            wrote(out / name)


def _rows(rows: list[dict[str, Any]]) -> list[tuple[str, ...]]:
    head = ("degree", "method", "functions", "condition", "iterations", "seconds", "rms mm", "above minimum")
    return [(*head, "iterations to 1 %", "seconds to 1 %"), *(_row(row) for row in rows)]


def _row(row: dict[str, Any]) -> tuple[str, ...]:
    arrived = (row["iterations_to_1_percent"], row["seconds_to_1_percent"])
    return (
        str(row["degree"]),
        row["method"],
        f"{row['functions']:.0f}",
        f"{row['condition']:.3g}",
        f"{row['iterations']:.0f}",
        f"{row['seconds']:.3g}",
        f"{row['rms_mm']:.4f}",
        f"{row['excess']:.2g}",
        *("-" if value is None else f"{value:.3g}" for value in arrived),
    )
