"""Sessions of a lab that were prepared wrongly: each change, the cause that must be named, and its key."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from dvf_ig.core import (
    Chamber,
    CycleTiming,
    DvfModel,
    FloatArray,
    Grid,
    ImageMap,
    Landmarks,
    Mesh,
    Points,
    Rigid,
    VolumeSeries,
)
from dvf_ig.intake.findings import Disagreement
from dvf_ig.intake.parts import SessionFiles

Change = Callable[[SessionFiles], SessionFiles]
RIGHT_MM = np.array([0.0, 0.0, -40.0])
"""Start that brings the images of the toy lab into a heart of 90 mm."""


def in_sequence(*changes: Change) -> Change:
    def change(parts: SessionFiles) -> SessionFiles:
        for one in changes:
            parts = one(parts)
        return parts

    return change


def with_model(**changes: object) -> Change:
    def change(parts: SessionFiles) -> SessionFiles:
        assert parts.preop is not None
        assert parts.preop.model is not None
        model = replace(parts.preop.model, **changes)  # type: ignore[arg-type]
        return replace(parts, preop=replace(parts.preop, model=model))

    return change


def large_heart(parts: SessionFiles) -> SessionFiles:
    surface = Mesh("mr", 90.0 * np.eye(3), np.array([[0, 1, 2]]))
    assert parts.model is not None
    return with_model(reference=(surface,) * parts.model.phases)(parts)


def start(rotation: FloatArray, translation_mm: FloatArray) -> Change:
    pose = Rigid("mr", "tracker", rotation, translation_mm)
    return in_sequence(large_heart, lambda parts: replace(parts, start=replace(parts.start, start=pose)))


def inverse_poses(parts: SessionFiles) -> SessionFiles:
    assert parts.sweep is not None
    probe = parts.sweep.probe
    turned = np.swapaxes(probe.rotations, 1, 2)
    shifted = -np.einsum("nij,nj->ni", turned, probe.translations_mm)
    return replace(
        parts, sweep=replace(parts.sweep, probe=replace(probe, rotations=turned, translations_mm=shifted))
    )


def inverse_probe(parts: SessionFiles) -> SessionFiles:
    """The image lies 70 mm below its marker, and the start brings it into the heart from there."""
    assert isinstance(parts.probe, ImageMap)
    inverse = replace(parts.probe.rigid, translation_mm=np.array([0.0, 0.0, -70.0]))
    return start(np.eye(3), RIGHT_MM - [0.0, 0.0, 70.0])(
        replace(parts, probe=ImageMap(inverse, parts.probe.scale_mm_per_px))
    )


def touched(change: Callable[[Landmarks], Landmarks]) -> Change:
    def changed(parts: SessionFiles) -> SessionFiles:
        at = parts.start.landmarks_tracker
        assert at is not None
        return replace(parts, start=replace(parts.start, landmarks_tracker=change(at)))

    return changed


def exchange_names(at: Landmarks) -> Landmarks:
    first, second, *others = at.names
    return Landmarks((second, first, *others), at.points)


def in_metres(at: Landmarks) -> Landmarks:
    return Landmarks(at.names, Points(at.frame, 1e-3 * at.points.xyz_mm))


def still_heart(parts: SessionFiles) -> SessionFiles:
    assert parts.model is not None
    first = parts.model.coefficients[:1]
    return with_model(coefficients=np.repeat(first, parts.model.phases, axis=0))(parts)


def blood(*sides: float) -> Change:
    """A chamber of these sizes over the model's four phases, from near the R peak on."""
    corners = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]])
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    return with_model(chambers=(Chamber("lv_blood", tuple(Mesh("mr", s * corners, faces) for s in sides)),))


def cine(roll: int, *, of_the_model: bool = True, stated: bool = True) -> Change:
    """Ten phases of grey levels that change as the model moves, `roll` phases late."""
    amounts = np.array([0, 2, 6, 8, 5, 2, 1, 4, 5, 2], dtype=np.float64)
    way = np.concatenate([[0.0], np.cumsum(amounts)[:-1]])
    back = np.minimum(way, way[-1] + amounts[-1] - way)
    timing = CycleTiming.uniform(10, 0.8)
    grid = Grid.axis_aligned("mr", (12, 12, 12), [0.0] * 3, 8.0)
    texture = np.random.default_rng(3).normal(size=grid.shape)
    grey = VolumeSeries(grid, np.roll(back, roll)[:, None, None, None] * texture, timing)

    def change(parts: SessionFiles) -> SessionFiles:
        assert parts.preop is not None
        model = ten_phases(parts.preop.model, 60.0 + back, timing)
        fingerprint = grey.fingerprint() if of_the_model else "0" * 64
        model = replace(model, cine_fingerprint=fingerprint)
        preop = replace(parts.preop.preop, mr=grey)
        return replace(parts, preop=replace(parts.preop, preop=preop, model=model, patient_stated=stated))

    return change


def ten_phases(model: DvfModel | None, sides_mm: FloatArray, timing: CycleTiming) -> DvfModel:
    assert model is not None
    meshes = tuple(Mesh("mr", side * np.eye(3), np.array([[0, 1, 2]])) for side in sides_mm)
    return replace(
        model,
        timing=timing,
        coefficients=model.coefficients[0] + np.reshape(sides_mm, (-1, 1, 1, 1)),
        reference=meshes,
        reference_caps=(np.zeros(1, dtype=np.bool_),) * len(meshes),
    )


FLIP = np.diag([-1.0, -1.0, 1.0])
CASES: dict[str, tuple[Change, Disagreement, str]] = {
    "the start's inverse": (start(np.eye(3), -RIGHT_MM), Disagreement.INVERSE_START, "start.transform"),
    "the poses' inverses": (
        in_sequence(start(np.eye(3), RIGHT_MM), inverse_poses),
        Disagreement.INVERSE_POSES,
        "ultrasound",
    ),
    "the probe calibration's inverse": (inverse_probe, Disagreement.INVERSE_PROBE, "calibration.probe"),
    "a start in RAS": (start(FLIP, RIGHT_MM), Disagreement.START_FLIPPED, "start.transform"),
    "names of landmarks exchanged": (
        touched(exchange_names),
        Disagreement.NAMES_EXCHANGED,
        "start.landmarks_tracker",
    ),
    "landmarks in m": (touched(in_metres), Disagreement.LANDMARKS_NOT_IN_MM, "start.landmarks_tracker"),
    "a heart that does not beat": (still_heart, Disagreement.HEART_DOES_NOT_BEAT, "preop.model"),
    "a cine from another phase on": (
        blood(20.0, 26.0, 25.0, 22.0),
        Disagreement.CINE_ORDER_UNUSUAL,
        "preop.model",
    ),
    "a cine that runs backwards": (
        blood(26.0, 25.0, 22.0, 20.0),
        Disagreement.CINE_ORDER_UNUSUAL,
        "preop.model",
    ),
    "grey levels of another phase order": (cine(3), Disagreement.MR_OF_OTHER_ORDER, "preop.mr"),
    "another patient's model": (
        cine(0, of_the_model=False, stated=False),
        Disagreement.MODEL_OF_OTHER_CINE,
        "preop.model",
    ),
}
