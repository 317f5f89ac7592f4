"""`dvf-ig study pairs`: registration of pairs of organ images that do not beat, one trial a pair."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from dvf_ig.cli.shell import JsonFlag, command, cores_or, emit, progress, wrote
from dvf_ig.cli.voxel_size import VoxelOption, voxel_size

from .options import FirstSeedOption, FolderOption, SchedulerOption, SeedsOption, WorkersOption

if TYPE_CHECKING:
    from dvf_ig.study.pairs.summary import PairGroup
    from dvf_ig.study.share import Share


def pairs(
    out: FolderOption,
    seeds: SeedsOption = 20,
    seed: FirstSeedOption = 3001,
    contrasts: Annotated[
        list[str] | None,
        typer.Option(
            "--contrasts", help="Of brains: t1, flair, t2 or several joined by +; may be given again."
        ),
    ] = None,
    cines: Annotated[
        Path | None,
        typer.Option(
            "--cines",
            help="Instead of brains: real MR at end-diastole of the cines in this folder.",
        ),
    ] = None,
    patients: Annotated[
        str | None, typer.Option("--patients", help="Only folders that end so: 002,003 (default: all).")
    ] = None,
    voxel_mm: VoxelOption = None,
    workers: WorkersOption = None,
    scheduler: SchedulerOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Register ultrasound and MR of simulated brains from 4 and 8 mm, and against another patient's MR.

    With --cines the MR is real and the ultrasound simulated from it; patients take turns with the seeds, and
    are what a claim is about. Seeds 1001–1999 are for tuning, 3001 and on for what is reported. Intervals are
    Wilson's over pairs.
    """
    size = voxel_size(voxel_mm)
    with command(lists_inputs=False):
        from dataclasses import asdict

        from dvf_ig.io import output_folder, write_json
        from dvf_ig.study.pairs.summary import summarise_pairs
        from dvf_ig.study.pairs.trial import pair_trial
        from dvf_ig.study.trials import Study, run_trials

        settings = _settings(contrasts, cines, patients, size)
        settings["starts_mm"] = [4.0, 8.0]
        with output_folder(out, ["summary.json"]), progress("pairs") as report:
            lines = run_trials(
                Study("pairs", settings, pair_trial),
                range(seed, seed + seeds),
                out,
                workers=cores_or(workers),
                scheduler=scheduler,
                progress=report,
            )
            groups = summarise_pairs(lines)
            summary = {"seed": seed, "seeds": seeds, **settings, "groups": [asdict(g) for g in groups]}
            write_json(out / "summary.json", summary)
        emit(summary, _table(groups), as_json=as_json)
        wrote(out / "trials.jsonl")
        wrote(out / "summary.json")


def _settings(
    contrasts: list[str] | None,
    cines: Path | None,
    patients: str | None,
    voxel_mm: "tuple[float, float, float] | None",
) -> dict[str, Any]:
    """The family of pairs, its contrasts and, of real MR, its patients.

    Raises:
        InvalidInputError: options of the other family, a contrast that is not simulated, or one patient.
    """
    from data_synth.organ_pair.mr import CONTRASTS
    from dvf_ig.core import InvalidInputError
    from dvf_ig.study.cines.patients import labelled_cines
    from dvf_ig.study.pairs.trial import Family

    if cines is None:
        if patients is not None or voxel_mm is not None:
            raise InvalidInputError("--patients and --voxel-mm are of cines; give --cines FOLDER")
        settings: dict[str, Any] = {
            "family": Family.brain,
            "contrasts": contrasts or ["t1", "flair", "t1+flair"],
        }
        known = set(CONTRASTS)
    else:
        found = labelled_cines(cines, tuple(patients.split(",")) if patients else ())
        if len(found) < 2:
            raise InvalidInputError("one patient; needed two, so that one can be taken for the other")
        settings = {
            "family": Family.cardiac_mr,
            "contrasts": contrasts or ["cine"],
            "patients": [str(path.resolve()) for path in found],
            "voxel_mm": voxel_mm,
        }
        known = {"cine"}
    unknown = {name for names in settings["contrasts"] for name in names.split("+")} - known
    if unknown:
        raise InvalidInputError(
            f"contrast '{min(unknown)}' is not simulated; choose {', '.join(sorted(known))}"
        )
    return settings


def _table(groups: "list[PairGroup]") -> list[tuple[str, ...]]:
    head = ("MR", "contrasts", "start mm", "below 2 mm", "median mm", "p95 mm", "good refused", "bad refused")
    rows: list[tuple[str, ...]] = [(*head, "CPU s")]
    for g in groups:
        start = f"{g.start_mm:g}" if g.start_mm else "–"
        errors = (_number(g.error_median_mm), _number(g.error_p95_mm))
        shares = (_share(g.good_refused), _share(g.bad_refused))
        seconds = f"{g.cpu_seconds_median:.1f}"
        rows.append((g.patient, g.contrasts, start, _share(g.success), *errors, *shares, seconds))
    return rows


def _share(share: "Share") -> str:
    if share.share is None or share.low is None or share.high is None:
        return "–"
    return f"{share.count} of {share.of} ({share.low:.0%}–{share.high:.0%})"


def _number(value: float | None) -> str:
    return "–" if value is None else f"{value:.2f}"
