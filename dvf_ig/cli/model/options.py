"""Options of `dvf-ig model build`."""

from pathlib import Path
from typing import Annotated

import typer

from dvf_ig.cli.shell import output_file

OutputOption = Annotated[
    Path, typer.Option("-o", "--out", callback=output_file, help="Model file to write (.npz).")
]
SurfacesOption = Annotated[
    Path | None, typer.Option("--surfaces", help="Folder (or archive) of surfaces, one mesh a phase.")
]
SurfaceOption = Annotated[str, typer.Option("--surface", help="Name of the surface to guard.")]
LabelsOption = Annotated[
    Path | None,
    typer.Option(
        "--labels",
        help="4-D label image; with --image, a 3-D one of end-diastole is enough (also .seg.nrrd).",
    ),
]
ImageOption = Annotated[
    Path | None, typer.Option("--image", help="4-D image, for the motion of --labels or --seeds.")
]
DicomOption = Annotated[
    Path | None,
    typer.Option(
        "--dicom",
        help="Folder of an examination with all its series: short-axis stack and long-axis cines are found "
        "by their geometry; the rest is left out with a reason.",
    ),
]
SaxOption = Annotated[
    Path | None, typer.Option("--sax", help="Short-axis 4-D stack, as --image, which --lax goes with.")
]
LaxOption = Annotated[
    list[Path] | None,
    typer.Option("--lax", help="Long-axis cine of one slice, with --sax or --image; once for each view."),
]
SeedsOption = Annotated[
    Path | None,
    typer.Option(
        "--seeds",
        help="Points named heart, cavity, background, any number of each name (.mrk.json, .fcsv, JSON).",
    ),
]
OrganOption = Annotated[
    str | None,
    typer.Option(
        "--organ",
        help="Label values inside the surface, for example 1,2,5 (default with --image: all except 0).",
    ),
]
CavityOption = Annotated[
    str | None,
    typer.Option(
        "--cavity",
        help="Label values of blood, the left ventricle's first, for example 3,1: end-systole is the phase "
        "in which the first is smallest; ultrasound shows the boundaries of all (default: those that "
        ".seg.nrrd names so).",
    ),
]
EdPhaseOption = Annotated[
    int, typer.Option("--ed-phase", min=0, help="With --image: the phase that is labelled.")
]
MotionOption = Annotated[str, typer.Option("--motion", help="With --image: bspline or demons.")]
TimingOption = Annotated[
    Path | None,
    typer.Option(
        "--timing",
        help='JSON file of phase times and RR: {"fractions": [0.0, 0.05, ...], "rr_s": 0.86} (default: '
        "timing.json next to the image).",
    ),
]
PatientOption = Annotated[
    str | None, typer.Option("--patient", help="Patient id (default: from the file's name).")
]
KnotOption = Annotated[float | None, typer.Option("--knot-mm", help="Spline knot pitch in mm (default 3).")]
AccuracyOption = Annotated[
    float | None,
    typer.Option(
        "--accuracy-mm",
        help="Required mean surface error in mm (p99: four times that): the coarsest knots that reach it "
        "on the most contracted phase.",
    ),
]
MarginOption = Annotated[float, typer.Option("--margin-mm", help="Box margin around the heart in mm.")]
LABELS_HELP = (
    "A label image and its position in the model's cycle. PHASE with a decimal point is a fraction of the "
    "cycle in [0, 1), a whole number one of the model's phases, counted from 0: es.nii.gz@0.35, "
    "es.seg.nrrd@11. For a 4-D image it selects the frame."
)
