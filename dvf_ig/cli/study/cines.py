"""`dvf-ig study cines`: labels propagated through real cines, against an expert's."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dvf_ig.cli.shell import (
    JsonFlag,
    ThreadsOption,
    command,
    cores_or,
    emit,
    output_dir,
    progress,
    warn,
    wrote,
)
from dvf_ig.cli.voxel_size import VoxelOption, voxel_size

if TYPE_CHECKING:
    from dvf_ig.study.cines.agreement import PatientAgreement


def cines(
    data: Annotated[
        Path,
        typer.Option(
            "--data",
            help="Folder of patients, each with cine_4d.nii.gz, ed_labels.nii.gz, es_labels.nii.gz (1 right "
            "ventricle, 2 myocardium, 3 left ventricle) and frames.json.",
        ),
    ],
    out: Annotated[Path, typer.Option("-o", "--out", callback=output_dir, help="Folder for summary.json.")],
    patients: Annotated[
        str | None, typer.Option("--patients", help="Only folders that end so: 002,003 (default: all).")
    ] = None,
    voxel_mm: VoxelOption = None,
    threads: ThreadsOption = None,
    as_json: JsonFlag = False,
) -> None:
    """Labels of end-diastole, moved to end-systole by the cine's own motion and left where they are."""
    size = voxel_size(voxel_mm)
    with command(threads):
        from dataclasses import asdict

        from dvf_ig.io import output_folder, write_json
        from dvf_ig.preop import MotionOptions
        from dvf_ig.study.cines.agreement import cine_agreement
        from dvf_ig.study.cines.patients import labelled_cines, read_labelled_cine

        folders = labelled_cines(data, tuple(patients.split(",")) if patients else ())
        found: list[PatientAgreement] = []
        with output_folder(out, ["summary.json"]), progress("cines") as report:
            for folder in folders:
                cine = read_labelled_cine(folder, size)
                found.append(cine_agreement(cine, MotionOptions(threads=min(cores_or(threads), 2))))
                report(len(found) / len(folders))
            summary = {"voxel_mm": size, "patients": [asdict(one) for one in found]}
            write_json(out / "summary.json", summary)
        for one in found:
            if one.replaced_phases:
                warn(f"{one.patient}: the motion of phases {list(one.replaced_phases)} was rejected")
            if one.stiffened_phases:
                warn(f"{one.patient}: phases {list(one.stiffened_phases)} were estimated anew, stiffer")
        emit(summary, _rows(found), as_json=as_json)
        wrote(out / "summary.json")


def _rows(found: "list[PatientAgreement]") -> list[tuple[str, ...]]:
    """Each number with the motion, and in brackets without."""
    rows: list[tuple[str, ...]] = [("patient", "structure", "Dice", "inner slices", "distance mm")]
    rows += [
        (
            one.patient + (" (voxel size given)" if one.spacing_given else ""),
            s.structure,
            f"{s.dice:.3f} ({s.dice_still:.3f})",
            f"{s.dice_inner:.3f} ({s.dice_inner_still:.3f})",
            f"{_mm(s.mean_mm)} ({_mm(s.mean_still_mm)})",
        )
        for one in found
        for s in one.structures
    ]
    for i, structure in enumerate(s.structure for s in found[0].structures):
        every = [one.structures[i] for one in found]
        dice, still, inner, inner_still, mm, still_mm = (
            _mean([getattr(s, name) for s in every])
            for name in ("dice", "dice_still", "dice_inner", "dice_inner_still", "mean_mm", "mean_still_mm")
        )
        rows.append(
            (
                f"mean of {len(every)}",
                structure,
                f"{dice:.3f} ({still:.3f})",
                f"{inner:.3f} ({inner_still:.3f})",
                f"{_mm(mm)} ({_mm(still_mm)})",
            )
        )
    return rows


def _mean(values: "list[float | None]") -> float | None:
    known = [value for value in values if value is not None]
    return sum(known) / len(known) if known else None


def _mm(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
