"""`dvf-ig model export`: the model's surface, one mesh a phase, for 3D Slicer and others."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.shell import JsonFlag, command, emit, wrote


class MeshFormat(StrEnum):
    """Ending of the files."""

    vtp = "vtp"
    stl = "stl"


def export(
    model_file: Annotated[Path, typer.Argument(metavar="MODEL", help="Model file.")],
    out: Annotated[Path, typer.Option("-o", "--out", help="Folder to write into.")],
    mesh_format: Annotated[
        MeshFormat, typer.Option("--format", help="vtp keeps every digit; stl holds 32-bit floats.")
    ] = MeshFormat.vtp,
    as_json: JsonFlag = False,
) -> None:
    """Write the surface that the model was fitted to, one mesh a phase: mm, LPS (tagged so for 3D Slicer)."""
    with command():
        from dvf_ig.io import output_folder, read_model, write_mesh

        model = read_model(model_file)
        with output_folder(out):
            files = [out / f"{model.surface_name}_{i:03d}.{mesh_format}" for i in range(model.phases)]
            for path, mesh in zip(files, model.reference, strict=True):
                write_mesh(mesh, path)
                wrote(path, model.frame)
        result = {
            "files": [path.name for path in files],
            "phase_fractions": list(model.timing.fractions),
            "surface": model.surface_name,
            "patient_id": model.patient_id,
            "frame": model.frame,
            "space": "LPS",
        }
        rows = [
            (path.name, f"phase {i}, at {fraction:.3f} RR")
            for i, (path, fraction) in enumerate(zip(files, model.timing.fractions, strict=True))
        ]
        emit(result, rows, as_json=as_json)
