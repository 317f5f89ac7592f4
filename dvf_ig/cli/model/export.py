"""`dvf-ig model export`: surface or signed distance, one file a phase, for 3D Slicer and others."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, Option

from dvf_ig.cli.shell import JsonFlag, command, emit, out_folder, wrote

if TYPE_CHECKING:
    from dvf_ig.core import DvfModel


CONTENT = {"vtp": "surface", "stl": "surface", "nrrd": "signed distance in mm, positive inside"}


def export(
    model_file: Annotated[Path, Argument(metavar="MODEL", help="Model file.")],
    out: Annotated[Path, out_folder("Folder to write into.")],
    form: Annotated[
        Literal["vtp", "stl", "nrrd"],
        Option(
            "--format",
            help="Surface: vtp (every digit) or stl (32-bit floats). nrrd: image of the signed distance.",
        ),
    ] = "vtp",
    as_json: JsonFlag = False,
) -> None:
    """Write the surface that the model was fitted to, or its distance: mm, LPS (tagged so for 3D Slicer).

    One file a phase. Where slices show a part of the surface only, VTP files flag the cells of the rest as
    "unseen". The distance is that of the splines, on every half knot of the model's box.
    """
    with command():
        from dvf_ig.io import files_together, output_folder, read_model

        model = read_model(model_file)
        with output_folder(out), files_together(out) as new:
            kind = "_distance" if form == "nrrd" else ""
            files = [out / f"{model.surface_name}{kind}_{i:03d}.{form}" for i in range(model.phases)]
            for phase, path in enumerate(files):
                _write_phase(model, phase, new / path.name, form)
        for path in files:
            wrote(path, model.frame)
        result = {
            "files": [path.name for path in files],
            "content": CONTENT[form],
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


def _write_phase(model: "DvfModel", phase: int, path: Path, form: str) -> None:
    from dvf_ig.io import write_mesh, write_volume
    from dvf_ig.preop import distance_volume

    if form == "nrrd":
        write_volume(distance_volume(model, phase), path)
    else:
        flags = {} if model.seen is None else {"unseen": model.unseen(phase)}
        write_mesh(model.reference[phase], path, flags)
