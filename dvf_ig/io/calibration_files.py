"""Read calibrations made earlier: tool tip, image calibration, lag, landmark map, hand-eye.

Each is the JSON that `dvf-ig calibrate … -o FILE` writes; those that are a transform may also be PLUS XML. A
calibration that a quality gate refused is also refused here, unless `allow_refused` is set.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal, TypeVar, get_args

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from dvf_ig.core import FloatArray, ImageMap, Points, QualityGateError, Rigid
from dvf_ig.core.errors import InvalidInputError, UnreadableFileError
from dvf_ig.core.plausible import lag_problem, pixel_problem, tip_problem
from dvf_ig.io.reading import reading

from . import limits
from .json_file import read_json
from .plus.names import same_sensor
from .plus.xml import CoordinateDefinition, parse_xml, read_calibrations, read_transforms
from .transform import rigid_from_matrix
from .yaml_config import validated

Number = Annotated[float, Field(allow_inf_nan=False)]
Row = tuple[Number, Number, Number, Number]
Matrix = tuple[Row, Row, Row, Row]


class CalibrationFile(BaseModel):
    """Verdict that every calibration file states; its other fields are evidence."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    refused: bool
    refused_because: tuple[str, ...]


class TipFile(CalibrationFile):
    """Result of `calibrate pivot`: the tip in mm, in the tool's own frame."""

    kind: Literal["tip"]
    tip_mm: tuple[Number, Number, Number]
    tip_frame: str


class ProbeFile(CalibrationFile):
    """Result of `calibrate probe`: sensor_from_image in mm per pixel, and its factors if stored.

    `image_orientation` is that of the images that were calibrated, MF as the reader turns them; None if the
    recording did not state one, absent in files of earlier versions, which calibrated images as stored.
    """

    kind: Literal["probe"]
    sensor_from_image: Matrix
    sensor_frame: str
    sensor_from_image_rigid: Matrix | None = None
    pixel_mm: tuple[Number, Number] | None = None
    image_orientation: str | None = None


class LatencyFile(CalibrationFile):
    """Result of `calibrate latency`: t_tracker = t_video + lag_s."""

    kind: Literal["latency"]
    lag_s: Number


class LandmarksFile(CalibrationFile):
    """Result of `calibrate landmarks`: target_from_source, mm."""

    kind: Literal["landmarks"]
    target_from_source: Matrix
    target: str
    source: str


class HandEyeFile(CalibrationFile):
    """Result of `calibrate hand-eye`: hand_from_camera, mm, with the recorded frame names."""

    kind: Literal["hand-eye"]
    hand_from_camera: Matrix
    target: str
    source: str


F = TypeVar("F", bound=CalibrationFile)


def read_tip(path: Path | str, tool: str | None = None, *, allow_refused: bool = False) -> Points:
    """Read a tool tip, mm, in the tool's own frame: JSON of `calibrate pivot` or PLUS StylusTipToStylus.

    Args:
        path: the file.
        tool: frame of the tool; needed if an XML file holds the tips of several tools.
        allow_refused: read a calibration that a quality gate refused.
    Raises:
        UnreadableFileError: absent, not a tip file, or the tip of another tool.
        QualityGateError: the calibration was refused.
    """
    path = Path(path)
    if path.suffix.lower() != ".xml":
        tip = _read(TipFile, path, "a tool tip", "pivot", allow_refused=allow_refused)
        if tool not in (None, tip.tip_frame):
            raise UnreadableFileError(f"{path} is the tip of '{tip.tip_frame}'; needed that of '{tool}'")
        with reading(path, "a tool tip"):
            limits.require_lengths(tip.tip_mm, "tip_mm")
            _refuse(tip_problem(tip.tip_mm))
            return Points(tip.tip_frame, np.array([tip.tip_mm]))
    tips = {
        d.target: d.matrix[:3, 3]
        for d in read_calibrations(path).values()
        if d.source == f"{d.target}_tip" and tool in (None, d.target)
    }
    if len(tips) != 1:
        listed = ", ".join(sorted(tips)) or "none"
        raise UnreadableFileError(
            f"{path} has tips of {len(tips)} tools ({listed}); needed one: name the tool"
        )
    frame, tip_mm = tips.popitem()
    with reading(path, "a tool tip"):
        _refuse(tip_problem(tip_mm))
    return Points(frame, tip_mm[None])


def read_probe(
    path: Path | str, sensor: str = "probe", *, turned_from: str | None = None, allow_refused: bool = False
) -> ImageMap:
    """Read probe_from_image of images in MF: JSON of `calibrate probe`, or ImageToProbe of a PLUS file.

    Args:
        path: the file.
        sensor: frame of the probe's sensor; a PLUS file may hold several sensors.
        turned_from: orientation in which the images to be used are stored, if they were turned to MF.
        allow_refused: read a calibration that a quality gate refused.
    Raises:
        UnreadableFileError: absent, not a probe calibration, that of another sensor, of images in another
            orientation, or of an unknown one when the images to be used were turned.
        QualityGateError: the calibration was refused.
    """
    path = Path(path)
    if path.suffix.lower() == ".xml":
        return read_image_map(path, sensor)
    calibration = _read(ProbeFile, path, "a probe calibration", "probe", allow_refused=allow_refused)
    if not same_sensor(calibration.sensor_frame, sensor):
        raise UnreadableFileError(
            f"{path} calibrates '{calibration.sensor_frame}'; needed '{sensor}': give this probe's "
            "calibration, or name its sensor",
            settings=("ultrasound.probe_name",),
        )
    orientation = calibration.image_orientation
    if (orientation is None and turned_from is not None) or (orientation or "MF")[:2] != "MF":
        raise UnreadableFileError(
            f"{path} calibrates images in {orientation or 'an orientation that is not stated'}, and "
            f"the recording's, stored as {turned_from or 'MF'}, are read as MF: they would be mirrored; "
            "calibrate the probe again (dvf-ig calibrate probe)"
        )
    with reading(path, "a probe calibration"):
        return _image_map(calibration, sensor)


def read_image_orientation(path: Path) -> str | None:
    """Read the orientation of the images that a probe was calibrated with; None if unstated, MF for PLUS.

    Raises:
        UnreadableFileError: absent, or not a calibration of this kind.
    """
    if path.suffix.lower() == ".xml":
        return "MF"
    orientation = _read(ProbeFile, path, "a probe calibration", "probe", allow_refused=True).image_orientation
    return None if orientation is None else orientation[:2]


def _image_map(calibration: ProbeFile, sensor: str) -> ImageMap:
    """Build the map from its factors, which keep every digit, if the file has them."""
    limits.require_lengths(calibration.sensor_from_image, "sensor_from_image")
    whole = ImageMap.from_matrix(calibration.sensor_from_image, sensor)
    _refuse(pixel_problem(whole.scale_mm_per_px))
    if calibration.sensor_from_image_rigid is None or calibration.pixel_mm is None:
        return whole
    rigid = rigid_from_matrix(calibration.sensor_from_image_rigid, sensor, "image")
    parts = ImageMap(rigid, np.array(calibration.pixel_mm))
    if not np.allclose(parts.matrix, whole.matrix, rtol=0, atol=1e-6):
        raise InvalidInputError("sensor_from_image is not the product of its rigid part and the pixel size")
    return parts


def read_lag(path: Path | str) -> float:
    """Read lag_s of `calibrate latency`: t_tracker = t_video + lag_s; negative if the tracker leads.

    Raises:
        UnreadableFileError: absent, or not a calibration of this kind.
        QualityGateError: the calibration was refused.
    """
    lag_s = _read(LatencyFile, Path(path), "a latency", "latency").lag_s
    with reading(Path(path), "a latency"):
        limits.require_times(lag_s, "lag_s")
        _refuse(lag_problem(lag_s))
    return lag_s


def read_landmark_map(path: Path | str) -> Rigid:
    """Read target_from_source of `calibrate landmarks`, for example reference_from_phantom.

    Raises:
        UnreadableFileError: absent, or not a calibration of this kind.
        QualityGateError: the calibration was refused.
    """
    path, what = Path(path), "a landmark calibration"
    calibration = _read(LandmarksFile, path, what, "landmarks")
    with reading(path, what):
        return rigid_from_matrix(calibration.target_from_source, calibration.target, calibration.source)


def read_hand_eye(path: Path | str) -> Rigid:
    """Read hand_from_camera of `calibrate hand-eye`: JSON, or PLUS XML with the names hand and camera.

    A JSON file states its own frame names.

    Raises:
        UnreadableFileError: absent, or not a calibration of this kind.
        QualityGateError: the calibration was refused.
    """
    path, what = Path(path), "a hand-eye calibration"
    with reading(path, what):
        if path.suffix.lower() != ".xml":
            calibration = _read(HandEyeFile, path, what, "hand-eye")
            return rigid_from_matrix(calibration.hand_from_camera, calibration.target, calibration.source)
        definition = read_calibrations(path).get("hand_from_camera")
        if definition is None:
            raise InvalidInputError("it has no transform hand_from_camera")
        return rigid_from_matrix(definition.matrix, "hand", "camera")


def _refuse(problem: str | None) -> None:
    """Raise InvalidInputError if there is a problem; `reading` names the file."""
    if problem is not None:
        raise InvalidInputError(problem)


def _read(schema: type[F], path: Path, what: str, command: str, *, allow_refused: bool = False) -> F:
    """Read a calibration file by its schema; raise if a quality gate refused it."""
    document = read_json(path, what)
    kind = document.get("kind") if isinstance(document, dict) else None
    if (kind,) != get_args(schema.model_fields["kind"].annotation):
        raise UnreadableFileError(
            f"{path} is not {what}" + (f" but of kind '{kind}'" if kind else "") + "; give what dvf-ig "
            f"calibrate {command} -o FILE wrote"
        )
    calibration = validated(schema, document, path)
    if calibration.refused and not allow_refused:
        raise QualityGateError(
            f"{path} is a refused calibration: {'; '.join(calibration.refused_because)}; calibrate again"
        )
    return calibration


SAME_MM = 0.1
"""Largest distance, at the corners of a square of CORNER_PX, of two ways from the image to the sensor."""
CORNER_PX = 500.0


def read_image_map(path: Path | str, sensor: str = "probe") -> ImageMap:
    """Read probe_from_image of a PLUS configuration or probe-calibration result.

    PLUS fits each column separately: the first two are made orthogonal, the third, of arbitrary length in
    PLUS's files, is rebuilt. The result's `shear_deg` states how far they were from orthogonal.

    Args:
        path: PLUS XML with `<Transform From="Image" To="Probe">`, or with a chain of transforms between them.
        sensor: name of the sensor's frame.
    Raises:
        UnreadableFileError: absent, not XML, no such transform, two ways from the image to the sensor that
            disagree, or image axes more than 1° off orthogonal.
    """
    path = Path(path)
    name = f"{sensor}_from_image"
    with reading(path, "a PLUS image calibration"):
        transforms = read_transforms(path, parse_xml(path, "a PLUS image calibration"))
        ways = dict(_ways(transforms, "image", sensor, np.eye(4), ("image",)))
        if not ways:
            raise UnreadableFileError(
                f"{path} has no transform {name}; it has {', '.join(sorted(transforms)) or 'none'}: give "
                "the file that holds it, or name its sensor",
                settings=("ultrasound.probe_name",),
            )
        chosen = min(ways, key=len)
        corners = np.array([[0, CORNER_PX, 0, CORNER_PX], [0, 0, CORNER_PX, CORNER_PX], [0] * 4, [1] * 4])
        for way, matrix in ways.items():
            apart = np.linalg.norm(((matrix - ways[chosen]) @ corners)[:3], axis=0).max()
            if apart > SAME_MM:
                raise UnreadableFileError(
                    f"{path}: the transforms {' to '.join(way)} and {' to '.join(chosen)} place the image "
                    f"{apart:.3g} mm apart; keep the ones that are true"
                )
        placed = ImageMap.from_matrix(ways[chosen], sensor)
        if problem := pixel_problem(placed.scale_mm_per_px):
            raise InvalidInputError(problem)
        return placed


def _ways(
    transforms: Mapping[str, CoordinateDefinition],
    at: str,
    to: str,
    before: FloatArray,
    passed: tuple[str, ...],
) -> Iterator[tuple[tuple[str, ...], FloatArray]]:
    """Yield every way from a frame to another: the frames that it passes, and its (4, 4) matrix."""
    if at == to:
        yield passed, before
        return
    for one in transforms.values():
        for source, target, forward in ((one.source, one.target, True), (one.target, one.source, False)):
            if source == at and target not in passed:
                if not forward and abs(np.linalg.det(one.matrix)) < 1e-12:
                    continue
                step = one.matrix if forward else np.linalg.inv(one.matrix)
                yield from _ways(transforms, target, to, step @ before, (*passed, target))
