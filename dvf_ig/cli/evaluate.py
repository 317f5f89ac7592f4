"""`dvf-ig evaluate`: target registration error of a transform."""

from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from .shell import JsonFlag, command, emit


def evaluate(
    transform: Annotated[Path, typer.Option("--transform", help="What `dvf-ig register` wrote.")],
    landmarks: Annotated[
        Path, typer.Option("--landmarks", help="Points on the fixed side (.mrk.json, .fcsv), or a .tag pair.")
    ],
    moving: Annotated[Path | None, typer.Argument(help="The same points on the moving side.")] = None,
    truth: Annotated[Path | None, typer.Option("--truth", help="True transform (.tfm).")] = None,
    as_json: JsonFlag = False,
) -> None:
    """Target registration error of a transform at landmarks that registration did not use.

    Either against the same points on the moving side, or against the true transform. For a scenario the fixed
    side is the tracker, the moving side the MR.
    """
    with command():
        result = _result(transform, landmarks, moving, truth)
        tre = result["tre_mm"]
        rows = [
            ("TRE", f"{tre['mean']:.2f} mm mean, {tre['median']:.2f} median, {tre['p95']:.2f} p95"),
            ("worst", f"{tre['max']:.2f} mm of {tre['n']} landmarks"),
        ]
        if result["rotation_deg"] is not None:
            shift = ", ".join(f"{v:.2f}" for v in result["translation_mm"])
            rows.append(("rotation error", f"{result['rotation_deg']:.2f} deg"))
            rows.append(("translation error", f"({shift}) mm at the landmarks' centre"))
        emit(result, rows, as_json=as_json)


def _result(transform: Path, landmarks: Path, moving: Path | None, truth: Path | None) -> dict[str, Any]:
    import numpy as np

    from dvf_ig.core import InvalidInputError, Landmarks
    from dvf_ig.io import read_landmarks, read_tag_pair, read_transform
    from dvf_ig.registration import pose_difference, summarise

    estimate = read_transform(_transform_file(transform))
    moving_points: Landmarks | None
    if landmarks.suffix == ".tag":
        fixed, moving_points = read_tag_pair(landmarks, estimate.source, estimate.target)
    else:
        fixed = read_landmarks(landmarks, estimate.source)
        moving_points = read_landmarks(moving, estimate.target) if moving is not None else None
    true = read_transform(truth, target=estimate.target, source=estimate.source) if truth else None
    if true is not None:
        wanted = true.apply(fixed.points).xyz_mm
        got = estimate.apply(fixed.points).xyz_mm
        turn, shift = pose_difference(estimate, true, wanted.mean(axis=0))
        difference: tuple[float | None, list[float] | None] = (turn, shift.tolist())
    elif moving_points is not None:
        _, points, targets = fixed.paired_with(moving_points)
        if len(points) == 0:
            raise InvalidInputError("fixed and moving landmarks share no name; name the same points alike")
        wanted, got = targets.xyz_mm, estimate.apply(points).xyz_mm
        difference = (None, None)
    else:
        raise InvalidInputError("one landmark file says nothing alone; add the moving side, or --truth FILE")
    errors = np.linalg.norm(got - wanted, axis=1)
    return {
        "tre_mm": asdict(summarise(errors)),
        "rotation_deg": difference[0],
        "translation_mm": difference[1],
    }


def _transform_file(given: Path) -> Path:
    """The transform itself, or the one that `dvf-ig register` wrote into a folder."""
    from dvf_ig.core import UnreadableFileError

    if not given.is_dir():
        return given
    found = sorted(given.glob("*_from_*.tfm"))
    if len(found) != 1:
        raise UnreadableFileError(
            f"{given} holds {len(found)} transforms; name one .tfm file or a folder of `dvf-ig register`"
        )
    return found[0]
