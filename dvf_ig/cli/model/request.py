"""Options of `dvf-ig model build` as one value, checked before any file is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from dvf_ig.core import OutputError

if TYPE_CHECKING:
    from dvf_ig.preop import ModelOptions, MotionOptions

METHODS = ("bspline", "demons")


@dataclass(frozen=True, slots=True)
class BuildRequest:
    """Source of a model, its meaning, and options of the fit.

    Attributes:
        output: the model's file; with an image, JSON and picture are written next to it.
        surfaces, labels, image, seeds: the source: surfaces, a 4-D label image, or a 4-D image with the
            labels of one phase or with seeds.
        surface: name of the guarded surface.
        organ, cavity: label values; for cavity, that of the left ventricle first.
        ed_phase, method: the labelled phase, and the method of motion estimation.
        timing: JSON file of phase times and RR.
        patient: identifier; None takes that of DICOM images, else the file's name.
        knot_mm, accuracy_mm, margin_mm, threads: options of the fit; see ModelOptions.
        seed: seed of the random points at which errors are measured.
        voxel_mm: voxel size of an image whose header has lost it.
        examination: the image is a folder of all series of an examination.
        views: files of long-axis cines, one slice each.
    Raises:
        typer.BadParameter: options that do not go together.
        OutputError: the folder of the output does not exist.
    """

    output: Path
    surfaces: Path | None
    labels: Path | None
    image: Path | None
    seeds: Path | None
    surface: str
    organ: tuple[int, ...]
    cavity: tuple[int, ...]
    ed_phase: int
    method: str
    timing: Path | None
    patient: str | None
    knot_mm: float | None
    accuracy_mm: float | None
    margin_mm: float
    threads: int
    seed: int
    voxel_mm: tuple[float, float, float] | None = None
    examination: bool = False
    views: tuple[Path, ...] = ()

    def __post_init__(self) -> None:
        if (self.surfaces is None) == (self.labels is None and self.image is None):
            raise typer.BadParameter("give --surfaces DIR, --labels SERIES, or --image and labels or seeds")
        if self.image is None and self.voxel_mm is not None:
            raise typer.BadParameter("--voxel-mm belongs to --image, the 4-D image whose header has lost it")
        if self.views and (self.image is None or self.examination):
            raise typer.BadParameter(
                "--lax goes with --sax, the short-axis stack; --dicom finds the views itself"
            )
        if self.image is None and self.seeds is not None:
            raise typer.BadParameter("--seeds needs --image, the 4-D image in which they are set")
        if self.surfaces is not None and (self.organ or self.cavity):
            raise typer.BadParameter(
                "--organ and --cavity belong to --labels; surfaces are identified by their names"
            )
        if not self.output.parent.is_dir():
            raise OutputError(
                f"cannot write {self.output}: the folder {self.output.parent} does not exist; make it first"
            )
        if self.knot_mm is not None and self.accuracy_mm is not None:
            raise typer.BadParameter("give either --knot-mm or --accuracy-mm")
        if self.image is not None:
            self._check_image()
        elif self.labels is not None and not self.organ:
            raise typer.BadParameter(
                "--labels needs --organ, the label values inside the surface, e.g. 1,2,5"
            )

    def _check_image(self) -> None:
        if self.method not in METHODS:
            raise typer.BadParameter(f"--motion is '{self.method}'; needed one of {', '.join(METHODS)}")
        if (self.labels is None) == (self.seeds is None):
            raise typer.BadParameter("--image needs either --labels (of end-diastole) or --seeds FILE")
        if self.voxel_mm is not None and self.seeds is not None:
            raise typer.BadParameter(
                "--voxel-mm needs --labels: seeds were set in the coordinates of the header"
            )
        if self.seeds is not None and (self.organ or self.cavity):
            raise typer.BadParameter("--organ and --cavity belong to --labels; seeds name their tissue")

    def patient_id(self, source: Path) -> str:
        from dvf_ig.io import dicom_patient_id, is_dicom_folder

        identified = self.patient or self.examination or not is_dicom_folder(source)
        recorded = "" if identified else dicom_patient_id(source)
        return self.patient or recorded or source.name.split(".")[0]

    def model_options(self) -> "ModelOptions":
        from dvf_ig.preop import ModelOptions

        return ModelOptions(
            self.knot_mm or ModelOptions().knot_spacing_mm,
            self.margin_mm,
            threads=self.threads,
            accuracy_mm=self.accuracy_mm,
        )

    def motion_options(self) -> "MotionOptions":
        from dvf_ig.preop import MotionOptions

        return MotionOptions(method="demons" if self.method == "demons" else "bspline", threads=self.threads)
