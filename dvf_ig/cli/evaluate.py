"""`dvf-ig evaluate`: target registration error of a transform."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, Option

from .shell import JsonFlag, command, emit, warn

if TYPE_CHECKING:
    from dvf_ig.core import FloatArray, Landmarks, Points, Rigid

FEWEST_PAIRS = 3
SWAPPED_SHARE = 0.5
"""Sides count as swapped if exchanging them at least halves the mean TRE."""


def evaluate(
    transform: Annotated[Path, Option(help="Result of `dvf-ig register`.")],
    landmarks: Annotated[Path, Option(help="Points on the fixed side (.mrk.json, .fcsv), or a .tag pair.")],
    moving: Annotated[Path | None, Argument(help="The same points on the moving side.")] = None,
    start: Annotated[
        Path | None, Option(help="Start pose (.tfm); default: the one in the result of `register`.")
    ] = None,
    truth: Annotated[Path | None, Option(help="True transform (.tfm).")] = None,
    moving_first: Annotated[
        bool, Option("--moving-first", help="The .tag pair lists the moving side first.")
    ] = False,
    as_json: JsonFlag = False,
) -> None:
    """Measure the target registration error of a transform at landmarks that registration did not use.

    The comparison is with the same points on the moving side, or with the true transform. For a scenario the
    fixed side is the tracker, the moving side the MR; for a pair of images they are the fixed and the moving
    image.
    """
    with command():
        result = _result(transform, landmarks, moving, truth, start, moving_first=moving_first)
        tre = result["tre_mm"]
        rows = [
            ("TRE", f"{tre['mean']:.2f} mm mean, {tre['median']:.2f} median, {tre['p95']:.2f} p95"),
            ("worst", f"{tre['max']:.2f} mm of {tre['n']} landmarks"),
        ]
        before = result["start_tre_mm"]
        if before is not None:
            rows.append(("TRE at the start", f"{before['mean']:.2f} mm mean, {before['max']:.2f} worst"))
        if result["rotation_deg"] is not None:
            shift = ", ".join(f"{v:.2f}" for v in result["translation_mm"])
            rows.append(("rotation error", f"{result['rotation_deg']:.2f} deg"))
            rows.append(("translation error", f"({shift}) mm at the landmarks' centre"))
        emit(result, rows, as_json=as_json)


def _result(
    transform: Path,
    landmarks: Path,
    moving: Path | None,
    truth: Path | None,
    start: Path | None,
    *,
    moving_first: bool,
) -> dict[str, Any]:
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io import read_transform
    from dvf_ig.registration import pose_difference

    file = _transform_file(transform)
    estimate = read_transform(file)
    fixed, theirs = _sides(landmarks, moving, estimate, moving_first)
    difference: tuple[float | None, list[float] | None] = (None, None)
    if truth is not None:
        true = read_transform(truth, target=estimate.target, source=estimate.source)
        points, targets_mm = fixed.points, true.apply(fixed.points).xyz_mm
        turn, shift = pose_difference(estimate, true, targets_mm.mean(axis=0))
        difference = (turn, shift.tolist())
    elif theirs is not None:
        points, targets = _pairs(fixed, theirs)
        targets_mm = targets.xyz_mm
        _require_one_unit(points.xyz_mm, targets_mm)
        _suspect_exchanged_names(fixed, theirs)
        _suspect_swapped_sides(estimate, points.xyz_mm, targets_mm)
    else:
        raise InvalidInputError("one landmark file is not enough; add the moving side, or --truth FILE")
    before = _start(file, start, estimate)
    return {
        "tre_mm": _tre_mm(estimate, points, targets_mm),
        "start_tre_mm": None if before is None else _tre_mm(before, points, targets_mm),
        "rotation_deg": difference[0],
        "translation_mm": difference[1],
    }


def _tre_mm(pose: "Rigid", points: "Points", targets_mm: "FloatArray") -> dict[str, Any]:
    import numpy as np

    from dvf_ig.core import summarise_errors

    return summarise_errors(np.linalg.norm(pose.apply(points).xyz_mm - targets_mm, axis=1)).tre_fields()


def _start(file: Path, start: Path | None, estimate: "Rigid") -> "Rigid | None":
    """Read the pose from which the registration started: from a file, or from the result's evidence."""
    from dvf_ig.core import Rigid
    from dvf_ig.io import read_json, read_transform

    if start is not None:
        return read_transform(start, target=estimate.target, source=estimate.source)
    names = (f"{file.stem}.result.json", "result.json")
    evidence = next((file.with_name(name) for name in names if file.with_name(name).is_file()), None)
    written = read_json(evidence) if evidence is not None else None
    if not isinstance(written, dict) or written.get("start") is None or estimate.name not in written:
        return None
    return Rigid.from_matrix(written["start"], estimate.target, estimate.source)


def _suspect_swapped_sides(estimate: "Rigid", fixed_mm: "FloatArray", moving_mm: "FloatArray") -> None:
    """Warn if the transform fits the landmarks far better with their sides exchanged."""
    import numpy as np

    def mean_mm(source: "FloatArray", target: "FloatArray") -> float:
        moved = source @ estimate.rotation.T + estimate.translation_mm
        return float(np.linalg.norm(moved - target, axis=1).mean())

    as_given, exchanged = mean_mm(fixed_mm, moving_mm), mean_mm(moving_mm, fixed_mm)
    if exchanged < SWAPPED_SHARE * as_given:
        warn(
            f"with the two sides of the landmarks exchanged the mean TRE is {exchanged:.2f} mm instead of "
            f"{as_given:.2f} mm: fixed and moving are probably swapped"
        )


def _require_one_unit(fixed_mm: "FloatArray", moving_mm: "FloatArray") -> None:
    """Refuse landmarks of which one side, or both, are in another unit than mm."""
    from dvf_ig.core import InvalidInputError
    from dvf_ig.intake.landmark_pairs import unit_of

    for side, xyz_mm, others_mm in (("fixed", fixed_mm, moving_mm), ("moving", moving_mm, fixed_mm)):
        unit = unit_of(xyz_mm, others_mm)
        if unit is not None:
            raise InvalidInputError(
                f"the {side} landmarks are in {unit}, not mm, by how far they are apart; export them in mm"
            )


def _suspect_exchanged_names(fixed: "Landmarks", moving: "Landmarks") -> None:
    """Warn if two or three names are on each other's points."""
    from dvf_ig.intake.landmark_pairs import exchanged_names

    exchanged = exchanged_names(fixed, moving)
    if exchanged is not None:
        warn(
            f"the names {exchanged.listed} are exchanged on one side: corrected, both sides fit each other "
            f"to {exchanged.exchanged_mm:.1f} mm RMS instead of {exchanged.given_mm:.1f} mm; correct "
            "the names and evaluate again"
        )


def _sides(
    landmarks: Path, moving: Path | None, estimate: "Rigid", moving_first: bool
) -> tuple["Landmarks", "Landmarks | None"]:
    """Read landmarks in the fixed frame and, if given, in the moving frame."""
    from dvf_ig.core import InvalidInputError
    from dvf_ig.io import read_landmarks, read_tag_pair

    pair = landmarks.suffix.lower() == ".tag" and moving is None
    if moving_first and not pair:
        raise InvalidInputError("--moving-first applies to one .tag file of two volumes; leave it out here")
    if pair and (moving_first or _states_moving_first(landmarks)):
        theirs, fixed = read_tag_pair(landmarks, estimate.target, estimate.source)
        return fixed, theirs
    if pair:
        return read_tag_pair(landmarks, estimate.source, estimate.target)
    fixed = read_landmarks(landmarks, estimate.source)
    return fixed, read_landmarks(moving, estimate.target) if moving is not None else None


def _states_moving_first(tag: Path) -> bool:
    """Whether the comments of a `.tag` pair name the MR, the moving side, before the ultrasound."""
    from dvf_ig.io import modalities_of_tag

    order = modalities_of_tag(tag)
    if order == ("MR", "US"):
        warn(f"{tag} says that its first side is the MR, which is taken as the moving side")
    elif order != ("US", "MR"):
        warn(
            f"{tag} does not say which side comes first; the first is taken as the fixed one, the "
            "ultrasound: give --moving-first if it is the MR"
        )
    return order == ("MR", "US")


def _pairs(fixed: "Landmarks", moving: "Landmarks") -> tuple["Points", "Points"]:
    """Pair the points that both sides name; warn of those that one side lacks."""
    from dvf_ig.core import InvalidInputError

    names, points, targets = fixed.paired_with(moving)
    alone = sorted(set(fixed.names) ^ set(moving.names))
    if len(names) < FEWEST_PAIRS:
        raise InvalidInputError(
            f"fixed and moving landmarks share {len(names)} names, needed at least {FEWEST_PAIRS}; give the "
            f"same points the same names on both sides (on one side only: {_some(alone)})"
        )
    if alone:
        warn(f"{len(alone)} landmarks are on one side only and are left out: {_some(alone)}")
    return points, targets


def _some(names: list[str]) -> str:
    return ", ".join(names[:6]) + (", …" if len(names) > 6 else "") if names else "none"


def _transform_file(path: Path) -> Path:
    """Return the transform itself, or the one that `dvf-ig register` wrote into a folder."""
    from dvf_ig.core import UnreadableFileError

    if not path.is_dir():
        return path
    transforms = sorted(path.glob("*_from_*.tfm"))
    if len(transforms) != 1:
        raise UnreadableFileError(
            f"{path} holds {len(transforms)} transforms; name one .tfm file or a folder of `dvf-ig register`"
        )
    return transforms[0]
