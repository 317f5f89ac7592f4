"""Faults that a start must refuse: axes, calibration, rigidity, the wrong patient."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np

from data_synth import NWireSpec, PhantomAnatomy, TrackerSpec, child_rng, nwire_recording, phantom_anatomy
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.calibration import validate_nwire
from dvf_ig.calibration.probe.errors import known_points_refusals
from dvf_ig.core import DvfIgError, DvfModel, FloatArray, ImageMap, Landmarks, Mesh, Points, Rigid
from dvf_ig.io import read_model, read_transform, write_model, write_transform
from dvf_ig.registration.start import require_on_model, require_unflipped, start_from_landmarks
from dvf_ig.study.faults.streams import HOME, wall_heart

RAS = np.array([-1.0, -1.0, 1.0])
TOUCH_MM, MARK_MM = 2.0, 2.0
"""Standard deviation, a coordinate, of a touched and of a marked point."""
PATIENT = "patient"

Start = Callable[[int], None]
"""Makes what a start is given from a seed, and starts; raises a DvfIgError where it is refused."""


@dataclass(frozen=True, slots=True)
class StartFault:
    """One fault of what a start is given.

    Attributes:
        start: with the fault.
        clean: the same without it, which must not be refused.
    """

    start: Start
    clean: Start


def refused(start: Start, seed: int) -> bool:
    """Whether a start is refused."""
    try:
        start(seed)
    except DvfIgError:
        return True
    return False


# ------------------------------------------------------------------ axes


@lru_cache(maxsize=2)
def _heart(seed: int) -> PhantomAnatomy:
    return phantom_anatomy(motion="paper5mm", mismatch_mm=0.0, seed=seed)


def _landmarks(seed: int, *, on_axis: bool) -> tuple[DvfModel, Landmarks, Landmarks]:
    """A model with its surface, and points marked on it and touched on the patient.

    Args:
        on_axis: the heart lies on the axis about which LPS and RAS differ by a turn.
    """
    heart, rng = _heart(seed), child_rng(seed, "start")
    off = heart.box_mm.mean(axis=0) * [1.0, 1.0, 0.0] if on_axis else np.zeros(3)
    surface = Mesh("mr", heart.ed_vertices_mm - off, heart.surface_triangles)
    model = wall_heart().model
    model = replace(
        model,
        patient_id=PATIENT,
        reference=(surface,) * model.phases,
        reference_caps=(np.zeros(len(surface.triangles), dtype=np.bool_),) * model.phases,
    )
    landmarks = heart.landmarks()
    there = landmarks.points.xyz_mm - off
    marked = there + MARK_MM * rng.standard_normal(there.shape)
    touched = HOME.inverse().apply_array(there) + TOUCH_MM * rng.standard_normal(there.shape)
    return (
        model,
        Landmarks(landmarks.names, Points("mr", marked)),
        Landmarks(landmarks.names, Points("tracker", touched)),
    )


def marked_in(signs: FloatArray, *, on_axis: bool = False) -> Start:
    """The marked landmarks hold flipped coordinates."""

    def start(seed: int) -> None:
        model, marked, _ = _landmarks(seed, on_axis=on_axis)
        flipped = Landmarks(marked.names, Points("mr", signs * marked.points.xyz_mm))
        require_on_model(flipped, model)

    return start


def posed_in(signs: FloatArray) -> Start:
    """The start pose holds flipped coordinates, as read from a file of the other convention."""

    def start(seed: int) -> None:
        _, marked, touched = _landmarks(seed, on_axis=False)
        right = start_from_landmarks(marked, touched).mr_from_tracker.perturbed_left(
            np.full(3, 0.08), np.full(3, 6.0), np.zeros(3)
        )
        turn = np.diag(signs)
        pose = Rigid("mr", "tracker", turn @ right.rotation @ turn, signs * right.translation_mm)
        require_unflipped(pose, marked, touched)

    return start


# ------------------------------------------------------------------ calibration and rigidity


def calibrated_off(by_mm: float) -> Start:
    """The probe's calibration puts every point this far off, in a direction of the image plane."""

    def start(seed: int) -> None:
        rng, probe = child_rng(seed, "calibration"), SectorProbe()
        plane = Rigid.from_rotation_vector(0.2 * rng.standard_normal(3), [5.0, 40.0, -8.0], "probe", "plane")
        true = ImageMap(plane @ probe.plane_from_image.rigid, probe.plane_from_image.scale_mm_per_px)
        size = (probe.columns, probe.rows)
        recording = nwire_recording(true, probe.fan, size, TrackerSpec(12.0), NWireSpec(frames=40), rng)
        angle = float(rng.uniform(0.0, 2.0 * np.pi))
        away = by_mm * (np.cos(angle) * true.rigid.rotation[:, 0] + np.sin(angle) * true.rigid.rotation[:, 1])
        rigid = Rigid("probe", "image", true.rigid.rotation, true.rigid.translation_mm + away)
        errors = validate_nwire(ImageMap(rigid, true.scale_mm_per_px), recording)
        for refusal in known_points_refusals(errors):
            raise DvfIgError(refusal.detail)

    return start


def pose_file_scaled(factor: float) -> Start:
    """A start pose whose file carries scale along one axis."""

    def start(seed: int) -> None:
        with TemporaryDirectory() as folder:
            path = Path(folder) / "start.tfm"
            write_transform(HOME, path)
            matrix = HOME.rotation.copy()
            matrix[:, seed % 3] *= factor
            numbers = " ".join(f"{x:.15g}" for x in (*matrix.ravel(), *HOME.translation_mm))
            lines = path.read_text(encoding="ascii").splitlines()
            lines = [f"Parameters: {numbers}" if x.startswith("Parameters:") else x for x in lines]
            path.write_text("\n".join(lines) + "\n", encoding="ascii")
            read_transform(path, target="mr", source="tracker")

    return start


# ------------------------------------------------------------------ patient


def of_patient(name: str) -> Start:
    """The model of a patient of that name, for PATIENT."""

    def start(seed: int) -> None:
        replace(wall_heart().model, patient_id=name).require_patient(PATIENT)

    return start


def with_bytes_changed(count: int) -> Start:
    """Start with a model file of which `count` bytes were changed after it was written."""

    def start(seed: int) -> None:
        rng = child_rng(seed, "bytes")
        with TemporaryDirectory() as folder:
            path = Path(folder) / "model.npz"
            write_model(wall_heart().model, path)
            data = bytearray(path.read_bytes())
            for at in rng.choice(len(data), count, replace=False).tolist():
                data[at] ^= 1 << int(rng.integers(8))
            path.write_bytes(bytes(data))
            read_model(path)

    return start
