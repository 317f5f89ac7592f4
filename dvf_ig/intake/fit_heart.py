"""Whether the files of the pre-operative heart fit each other."""

from dvf_ig.core.arrays import FloatArray
from dvf_ig.core.errors import InvalidInputError
from dvf_ig.core.recordings.scenario import Preop
from dvf_ig.core.space.volume import Grid
from dvf_ig.intake.preop import PreopFiles, label_values
from dvf_ig.intake.problem import Problem, ProblemList

LEAST_INSIDE = 0.5
"""Of a model's surface in the images that it goes with; a cine may cut off apex or base."""


def misfits_of_heart(files: PreopFiles) -> list[Problem]:
    """What does not fit among model, images, labels and surfaces."""
    problems = ProblemList()
    preop, model = files.preop, files.model
    if preop.surfaces and model is None:
        names = [series.name for series in preop.surfaces]
        with problems.about("preop.surface"):
            if preop.surface not in names:
                raise InvalidInputError(
                    f"there is no surface '{preop.surface}'; name one of {', '.join(names)}"
                )
    if preop_label_values(preop):
        with problems.about("preop.organ_labels"):
            _require_labels(preop)
    if preop.mr is not None and preop.labels is not None:
        with problems.about("preop.labels"):
            if len(preop.mr.timing) != len(preop.labels.timing):
                raise InvalidInputError(
                    f"the labels have {len(preop.labels.timing)} phases, the grey levels (mr) have "
                    f"{len(preop.mr.timing)}; needed as many, or labels of end-diastole alone"
                )
    if preop.mr is not None and model is not None:
        with problems.about("preop.mr"):
            _require_inside(model.reference[model.ed_phase].vertices_mm, preop.mr.grid)
    return problems.found


def _require_labels(preop: Preop) -> None:
    there = preop_label_values(preop)
    listed = ", ".join(map(str, there)) or "none"
    absent = sorted(set(preop.organ_labels) - set(there))
    if preop.organ_labels and len(absent) == len(set(preop.organ_labels)):
        raise InvalidInputError(
            f"the image has none of the labels {', '.join(map(str, absent))}; it has {listed}"
        )


def preop_label_values(preop: Preop) -> tuple[int, ...]:
    """The values in the label image, of every phase or of end-diastole, without 0."""
    labels = preop.labels if preop.labels is not None else preop.ed_labels
    return () if labels is None else label_values(labels)


def _require_inside(vertices_mm: FloatArray, grid: Grid) -> None:
    inside = float(grid.holds(grid.to_index(vertices_mm), margin=0.5).mean())
    if inside < LEAST_INSIDE:
        raise InvalidInputError(
            f"{inside:.0%} of the model's surface lies in these images, needed {LEAST_INSIDE:.0%}; give the "
            "images that the model was built from"
        )
