"""A coarse start from anatomical points touched on the patient and marked on the model."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import FloatArray, InvalidInputError, Landmarks, Rigid
from dvf_ig.core.paired import fit_paired_points


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkStart:
    """mr_from_tracker from paired landmarks, with the residual of each in mm (FRE, not an accuracy)."""

    mr_from_tracker: Rigid
    names: tuple[str, ...]
    residuals_mm: FloatArray


def start_from_landmarks(mr: Landmarks, tracker: Landmarks) -> LandmarkStart:
    """Least-squares rigid fit of the landmarks that both sets name.

    Raises:
        InvalidInputError: fewer than three common names, or all on one line.
    Source: Arun 1987; see `core.paired`.
    """
    names, target, source = mr.paired_with(tracker)
    if len(names) < 3:
        raise InvalidInputError(
            f"model and patient share {len(names)} landmark names ({', '.join(names) or 'none'}); "
            "needed at least 3: name the same points alike in both files"
        )
    pose = fit_paired_points(target, source)
    residuals = np.linalg.norm(pose.apply(source).xyz_mm - target.xyz_mm, axis=1)
    return LandmarkStart(pose, names, residuals)
