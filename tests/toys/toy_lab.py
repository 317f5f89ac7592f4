"""A lab's own files, made in a moment: sweep, ECG, tracked needle, calibrations, model, landmarks."""

from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from toy_ball import RADII

from dvf_ig.core import DvfModel, FloatArray, Landmarks, Points, PoseStream, Rigid, TrackedSequence
from dvf_ig.io import write_landmarks, write_model, write_poses, write_sequence, write_sidecar

SECONDS = 12.0
NAMES = ("apex", "mitral", "aortic", "tricuspid")
SESSION: dict[str, Any] = {
    "schema": "dvf_ig.session/1",
    "preop": {"model": "heart.npz"},
    "ultrasound": {"file": "sweep.igs.mha"},
    "ecg": "csv:ecg.csv",
    "tool": {"file": "needle.igs.mha"},
    "calibration": {"probe": "probe.json", "latency": "latency.json", "tip": "tip.json"},
    "start": {"landmarks_mr": "model.mrk.json", "landmarks_tracker": "patient.mrk.json"},
}


def write_lab(folder: Path, model: DvfModel) -> None:
    """Every file that SESSION names."""
    write_model(model, folder / "heart.npz")
    write_sequence(sweep(), folder / "sweep.igs.mha")
    write_ecg(folder / "ecg.csv")
    write_poses(poses("needle"), folder / "needle.igs.mha")
    write_calibration(folder / "probe.json", "probe", sensor_frame="probe", sensor_from_image=IMAGE.tolist())
    write_calibration(folder / "latency.json", "latency", lag_s=-0.065)
    write_calibration(folder / "tip.json", "tip", tip_mm=[1.0, 2.0, 150.0], tip_frame="needle")
    mr = np.random.default_rng(1).normal(size=(len(NAMES), 3))
    mr *= RADII[0] / np.linalg.norm(mr, axis=1, keepdims=True)
    patient = Rigid(
        "tracker",
        "mr",
        Rotation.from_euler("xyz", [0.3, -0.2, 1.0]).as_matrix(),
        np.array([10.0, 20.0, 30.0]),
    )
    write_landmarks(Landmarks(NAMES, Points("mr", mr)), folder / "model.mrk.json")
    touched = patient.apply(Points("mr", mr))
    write_landmarks(Landmarks(NAMES, touched), folder / "patient.mrk.json")


IMAGE: FloatArray = np.diag([0.5, 0.5, 1.0, 1.0])


def sweep(
    probe: str = "probe", *, tracked: bool = True, also: tuple[str, ...] = (), images: bool = True
) -> TrackedSequence:
    """Images of a sector of speckle, 20 frames/s, with the probe and whatever else was tracked."""
    streams = [poses(probe, 0.5, SECONDS - 1, 20.0, tracked=tracked)]
    streams += [poses(name, 0.5, SECONDS - 1, 20.0) for name in also]
    count = len(streams[0])
    grey = np.random.default_rng(2).integers(1, 255, (count, 80, 60), dtype=np.uint8)
    grey[:, :, :15] = 0
    return TrackedSequence(
        streams[0].t_s, grey if images else None, np.ones(count, dtype=bool), {s.name: s for s in streams}
    )


def poses(
    source: str,
    begin_s: float = 0.0,
    seconds: float = SECONDS,
    rate_hz: float = 30.0,
    *,
    tracked: bool = True,
) -> PoseStream:
    """A marker that moves slowly: the needle's with its tip at the heart, every other one above it."""
    height_mm = -120.0 if source == "needle" else 60.0
    t_s = begin_s + np.arange(round(seconds * rate_hz)) / rate_hz
    turns = Rotation.from_rotvec(np.outer(0.05 * t_s, [0.0, 0.6, 0.8])).as_matrix()
    places = np.column_stack([5 * np.sin(t_s), 3 * np.cos(t_s), height_mm + t_s])
    return PoseStream("tracker", source, t_s, turns, places, np.full(len(t_s), tracked))


def write_ecg(path: Path, begin_s: float = 0.0, height: float = 1.0, *, times: bool = True) -> None:
    """A peak every 0.8 s at 250 Hz."""
    t = np.arange(int(SECONDS * 250)) / 250.0
    x = height * np.exp(-0.5 * (((t + 0.4) % 0.8 - 0.4) / 0.012) ** 2)
    x += 0.01 * np.random.default_rng(0).standard_normal(len(t))
    rows = [f"{begin_s + a:.3f},{b:.5f}" if times else f"{b:.5f}" for a, b in zip(t, x, strict=True)]
    path.write_text("\n".join(["t_s,II" if times else "II", *rows]) + "\n")


def write_calibration(path: Path, kind: str, refused: tuple[str, ...] = (), **result: Any) -> None:
    """What `calibrate -o` writes, as far as it is read again."""
    write_sidecar(path, {**result, "refused": bool(refused), "refused_because": list(refused)}, kind)
