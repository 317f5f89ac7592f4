"""Messages on the labels of blood if nothing states which they are."""

import numpy as np

from dvf_ig.cli.shell import warn
from dvf_ig.core import Volume, VolumeSeries


def warn_of_no_blood(what_to_do: str) -> None:
    """Warn that a model has no chambers of blood, with advice."""
    warn(
        "nothing states where the blood is, so the model holds no boundary of it, which registration to "
        f"ultrasound uses, and end-systole is the phase with the smallest whole volume: {what_to_do}"
    )


def describe_labels(image: VolumeSeries, labels: Volume, ed_phase: int) -> str:
    """Describe volume and mean grey level of each label at end-diastole: blood is bright in most cines."""
    voxel_ml = float(np.prod(labels.grid.spacing_mm)) / 1000.0
    grey = image.values[ed_phase]
    labels_text = []
    for value in np.unique(labels.values[labels.values != 0]).tolist():
        inside = labels.values == value
        labels_text.append(
            f"{value}: {inside.sum() * voxel_ml:.0f} ml of mean grey level {grey[inside].mean():.0f}"
        )
    return "; ".join(labels_text)
