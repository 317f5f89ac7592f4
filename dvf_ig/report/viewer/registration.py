"""Encode one registration for the viewer: planes with ultrasound and anatomy, targets with their bound."""

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import dvf_ig
from dvf_ig.core import AnyArray, DvfModel, Landmarks, Warp
from dvf_ig.guidance import FixtureSet
from dvf_ig.report.plane_overlay import PlaneOverlay

from .scene import SCHEMA, distance_payload, heart_payload, targets_payload, words

LONGEST_PX = 360
QUALITY = 80


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationView:
    """Content of the page of a registration.

    Attributes:
        title: of the page.
        patient_id: the patient; for an image pair, the files.
        usable, reason: whether the pose may be used, and why.
        rows: of name and value.
        planes: each with its position in the anatomy's frame.
        anatomy: image shown with the ultrasound, for example "MR".
        model: of the heart; None for an organ that does not beat.
        targets: named points of the anatomy.
        bound_mm: 95 % bound on the error at any of them; None if none is stated.
        warp: change of the heart's shape since the anatomy was imaged; None if none was found.
    """

    title: str
    patient_id: str
    usable: bool
    reason: str
    rows: Sequence[tuple[str, str]]
    planes: Sequence[PlaneOverlay]
    anatomy: str
    model: DvfModel | None
    targets: Landmarks | None
    bound_mm: float | None
    warp: Warp | None = None


def registration_payload(view: RegistrationView) -> dict[str, Any]:
    """Build the scene of a registration, `kind` "registration" (`dvf_ig/report/web/README.md`)."""
    pixel_mm, size = _common_size(view.planes)
    planes = [_plane(one, pixel_mm, size) for one in view.planes if one.anatomy_from_pixel is not None]
    model = view.model
    middle = [np.array(one["mr_from_pixel"]) @ [size[0] / 2, size[1] / 2, 1.0] for one in planes]
    heart = {"surfaces": [], "fractions": [0.0], "center_mm": np.mean(middle, axis=0).round(3).tolist()}
    return {
        "schema": SCHEMA,
        "kind": "registration",
        "title": view.title,
        "patient_id": view.patient_id,
        "version": dvf_ig.__version__,
        "heart": heart if model is None else heart_payload(model, None, view.warp),
        "distance": None if model is None else distance_payload(model),
        "fixtures": [],
        "fixtures_cap_n": FixtureSet().joint_cap_n,
        "image": {"columns": size[0], "rows": size[1], "pixel_mm": [pixel_mm, pixel_mm], "fan_px": None},
        "signals": {"ecg": None, "breathing": None},
        "words": words(),
        "age_limit_s": None,
        "targets": targets_payload(view.targets),
        "bound_mm": view.bound_mm,
        "usable": view.usable,
        "reason": view.reason,
        "rows": [list(row) for row in view.rows],
        "anatomy": view.anatomy,
        "planes": planes,
        "mime": "image/webp",
    }


def _common_size(planes: Sequence[PlaneOverlay]) -> tuple[float, tuple[int, int]]:
    """Choose a pixel size in mm, and columns and rows, that fit every plane."""
    widest, tallest = (max(one.size_mm[a] for one in planes) for a in range(2))
    finest = min(min(one.pixel_mm) for one in planes)
    pixel_mm = max(finest, max(widest, tallest) / LONGEST_PX)
    return pixel_mm, (int(np.ceil(widest / pixel_mm)), int(np.ceil(tallest / pixel_mm)))


def _plane(one: PlaneOverlay, pixel_mm: float, size: tuple[int, int]) -> dict[str, Any]:
    columns, rows = (max(1, round(length / pixel_mm)) for length in one.size_mm)
    step = np.array([one.image.shape[1] / columns, one.image.shape[0] / rows])
    recorded_from_sent = np.diag([*step, 1.0])
    recorded_from_sent[:2, 2] = (step - 1) / 2
    placed = np.asarray(one.anatomy_from_pixel) @ recorded_from_sent
    grey = np.nan_to_num(255.0 * one.registered.grey).astype(np.uint8)
    return {
        "name": one.name,
        "place": one.plane,
        "moment": one.moment,
        "model_phase": one.model_phase,
        "mr_from_pixel": placed.round(6).tolist(),
        "image": _picture(one.image, (columns, rows), size),
        "anatomy": _picture(grey, (columns, rows), size),
    }


def _picture(image: NDArray[np.uint8], shown: tuple[int, int], size: tuple[int, int]) -> str:
    """Place an image at the upper left of a black canvas of `size`, as WebP in base64."""
    canvas = np.zeros((size[1], size[0]), dtype=np.uint8)
    columns, rows = min(shown[0], size[0]), min(shown[1], size[1])
    canvas[:rows, :columns] = cv2.resize(image, (columns, rows), interpolation=cv2.INTER_AREA)
    data: AnyArray = cv2.imencode(".webp", canvas, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])[1]
    return base64.b64encode(data.tobytes()).decode("ascii")
