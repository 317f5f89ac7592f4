"""A lab's files and configuration, each time with one thing wrong, and words of the sentence that says so."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import SimpleITK
from toy_lab import poses, sweep, write_calibration, write_ecg

from dvf_ig.core import Landmarks, Points, Rigid
from dvf_ig.io import (
    write_coordinate_definitions,
    write_landmarks,
    write_poses,
    write_sequence,
    write_transform,
)

Document = dict[str, Any]
Spoil = Callable[[Path, Document], None]
"""Spoils the files of a folder, or the document."""


def put(key: str, value: Any) -> Spoil:
    """Set, or with None remove, a key of the document."""

    def spoil(_folder: Path, document: Document) -> None:
        *sections, last = key.split(".")
        for section in sections:
            document = document.setdefault(section, {})
        if value is None:
            del document[last]
        else:
            document[last] = value

    return spoil


def both(*steps: Spoil) -> Spoil:
    def spoil(folder: Path, document: Document) -> None:
        for step in steps:
            step(folder, document)

    return spoil


def file(write_file: Callable[[Path], object]) -> Spoil:
    """Spoil a file."""
    return lambda folder, _document: (write_file(folder), None)[1]


def truncate(folder: Path) -> None:
    path = folder / "sweep.igs.mha"
    path.write_bytes(path.read_bytes()[:-9000])


def change_byte(folder: Path) -> None:
    data = bytearray((folder / "heart.npz").read_bytes())
    data[len(data) // 2] ^= 0xFF
    (folder / "heart.npz").write_bytes(data)


def landmarks(*names: str) -> Callable[[Path], None]:
    at = np.random.default_rng(3).normal(size=(len(names), 3)) * 30
    return lambda folder: write_landmarks(
        Landmarks(names, Points("tracker", at)), folder / "patient.mrk.json"
    )


def image(
    name: str, *size: int, value: int = 1, origin_mm: float = 90.0, spacing_mm: float = 1.0
) -> Callable[[Path], None]:
    def write_image(folder: Path) -> None:
        voxels = np.full(size[:3][::-1], value, np.uint8)
        phases = [SimpleITK.GetImageFromArray(voxels)] * (size[3] if len(size) > 3 else 1)
        made = phases[0] if len(size) == 3 else SimpleITK.JoinSeries(phases)
        made.SetOrigin((origin_mm,) * len(size))
        made.SetSpacing((*[spacing_mm] * 3, 1.0)[: len(size)])
        SimpleITK.WriteImage(made, str(folder / name))

    return write_image


def inverse_start(folder: Path) -> None:
    write_transform(Rigid.identity("tracker", "mr"), folder / "start.tfm")


def device_set(folder: Path) -> None:
    write_coordinate_definitions(folder / "device.xml", {"stylus_from_image": np.eye(4)})


def few_points(folder: Path) -> None:
    (folder / "touched.csv").write_text("x,y,z\n0,0,0\n10,0,0\n0,10,0\n")


LFS = b"version https://git-lfs.github.com/spec/v1\noid sha256:" + b"0" * 64 + b"\nsize 1234567\n"

WRONG: dict[str, tuple[Spoil, list[str]]] = {
    "a name misspelt": (
        put("calibration.tip", "tp.json"),
        ["calibration.tip: ", "lab/tp.json does not exist; copy it there, or correct its name"],
    ),
    "an unknown key": (
        put("calibration.stylus", "tip.json"),
        ["session.yaml: calibration: unknown key stylus; needed some of probe, latency, tip"],
    ),
    "a calibration left out": (
        put("calibration.probe", None),
        [
            "calibration.probe: a registration needs",
            "dvf-ig calibrate probe SWEEP --device-set XML -o probe.json",
        ],
    ),
    "one file of landmarks": (
        put("start.landmarks_tracker", None),
        ["session.yaml: start: landmarks need both landmarks_mr and landmarks_tracker"],
    ),
    "a sweep that Git-LFS left": (
        file(lambda folder: (folder / "sweep.igs.mha").write_bytes(LFS)),
        ["ultrasound.file: ", "sweep.igs.mha is a Git-LFS pointer", "git lfs pull"],
    ),
    "a truncated sweep": (
        file(truncate),
        ["ultrasound.file: ", "sweep.igs.mha", "is truncated", "copy or record it again"],
    ),
    "a sweep of poses alone": (
        file(lambda folder: write_sequence(sweep(images=False), folder / "sweep.igs.mha")),
        ["ultrasound.file: ", "sweep.igs.mha", "no images; record the ultrasound's video with them"],
    ),
    "a probe that was never tracked": (
        file(lambda folder: write_sequence(sweep(tracked=False), folder / "sweep.igs.mha")),
        ["ultrasound.file: ", "sweep.igs.mha", "none of the 220 poses", "check the line of sight"],
    ),
    "a probe by another name": (
        file(lambda folder: write_sequence(sweep(probe="us_head"), folder / "sweep.igs.mha")),
        ["ultrasound.file: ", "sweep.igs.mha", "it records tracker_from_us_head", "ultrasound.probe_name"],
    ),
    "another day's ECG": (
        file(lambda folder: write_ecg(folder / "ecg.csv", begin_s=5000.0)),
        [
            "ecg.file: ",
            "ecg.csv: ECG (5000",
            "ultrasound (0.5 to 11.4 s) share less than a second",
            "ecg.start_s",
            "one clock",
        ],
    ),
    "an ECG without beats": (
        file(lambda folder: write_ecg(folder / "ecg.csv", height=0.0)),
        ["ecg.file: ", "ecg.csv", "R peaks", "check the electrodes and the lead"],
    ),
    "an ECG without times": (
        file(lambda folder: write_ecg(folder / "ecg.csv", times=False)),
        ["ecg.file: ", "ecg.csv", "ecg.rate_hz"],
    ),
    "an ECG of no known kind": (
        put("ecg", "heart.npz"),
        ["ecg.file: ", "heart.npz' names no ECG; write wfdb:RECORD, edf:FILE, csv:FILE"],
    ),
    "a calibration of another sensor": (
        file(
            lambda folder: write_calibration(
                folder / "probe.json", "probe", sensor_frame="stylus", sensor_from_image=np.eye(4).tolist()
            )
        ),
        ["calibration.probe: ", "probe.json calibrates 'stylus'; needed 'probe'", "ultrasound.probe_name"],
    ),
    "a device set without the image": (
        both(file(device_set), put("calibration.probe", "device.xml")),
        ["calibration.probe: ", "device.xml has no transform probe_from_image; it has stylus_from_image"],
    ),
    "a refused calibration": (
        file(
            lambda folder: write_calibration(
                folder / "tip.json", "tip", ("RMS is 2.2 mm",), tip_mm=[0, 0, 1], tip_frame="needle"
            )
        ),
        ["calibration.tip: ", "tip.json is a refused calibration: RMS is 2.2 mm; calibrate again"],
    ),
    "a calibration in metres": (
        file(
            lambda folder: write_calibration(
                folder / "probe.json",
                "probe",
                sensor_frame="probe",
                sensor_from_image=np.diag([5e-4, 5e-4, 1, 1]).tolist(),
            )
        ),
        ["calibration.probe: ", "probe.json", "its pixels have 0.0005 to 0.0005 mm", "not in mm per pixel"],
    ),
    "a latency in ms": (
        put("calibration.latency", -65.0),
        ["calibration.latency: the latency is -65 s; needed -1 to 1 s (is it in ms?)"],
    ),
    "tip and latency swapped": (
        both(put("calibration.latency", "tip.json"), put("calibration.tip", None)),
        ["calibration.latency: ", "tip.json is not a latency but of kind 'tip'", "calibrate latency -o FILE"],
    ),
    "the tip of another tool": (
        file(
            lambda folder: write_calibration(
                folder / "tip.json", "tip", tip_mm=[0, 0, 150], tip_frame="stylus"
            )
        ),
        [
            "calibration.tip: ",
            "tip.json is the tip of 'stylus', but the recorded tool is 'needle'",
            "tool.name",
        ],
    ),
    "a tool that was never tracked": (
        file(lambda folder: write_poses(poses("needle", tracked=False), folder / "needle.igs.mha")),
        ["tool.file: ", "needle.igs.mha", "none of the 360 poses", "check the line of sight"],
    ),
    "another day's tool": (
        file(lambda folder: write_poses(poses("needle", 900.0), folder / "needle.igs.mha")),
        ["tool.file: ", "needle.igs.mha", "tool (900.0 to 912.0 s) share less than a second", "one clock"],
    ),
    "two common landmarks": (
        file(landmarks("apex", "mitral", "Aorta", "Tricuspid")),
        [
            "start.landmarks_tracker: ",
            "patient.mrk.json",
            "share 2 landmark names (apex, mitral)",
            "same names in both files",
        ],
    ),
    "a start in the other direction": (
        both(file(inverse_start), put("start.transform", "start.tfm")),
        ["start.transform: ", "start.tfm is tracker_from_mr; needed mr_from_tracker"],
    ),
    "three touched points": (
        both(file(few_points), put("start.touched", "touched.csv")),
        ["start.touched: ", "touched.csv", "3 points were touched on the surface; needed at least"],
    ),
    "no start": (
        put("start", None),
        ["start: a registration needs a start: a coarse mr_from_tracker (.tfm)"],
    ),
    "another patient's model": (
        put("patient_id", "P-17"),
        [
            "preop.model: ",
            "heart.npz is the model of patient 'ball', needed patient 'P-17'",
            "give the other data the same name",
        ],
    ),
    "a damaged model": (
        file(change_byte),
        ["preop.model: ", "heart.npz is not an intact model file", "build it again"],
    ),
    "labels of end-diastole alone": (
        both(file(image("labels.nrrd", 9, 9, 9)), put("preop", {"labels": "labels.nrrd"})),
        ["preop.labels: ", "labels.nrrd holds the labels of one phase; give mr, the cine"],
    ),
    "labels that no voxel has": (
        both(
            file(image("labels.nrrd", 9, 9, 9, 4)),
            put("preop", {"labels": "labels.nrrd", "organ_labels": [7]}),
        ),
        ["preop.organ_labels: ", "labels.nrrd: the image has none of the labels 7; it has 1"],
    ),
    "a cine of somebody else": (
        both(file(image("cine.nrrd", 9, 9, 9, 4)), put("preop.mr", "cine.nrrd")),
        ["preop.mr: ", "cine.nrrd", "of the model's surface lies in these images"],
    ),
    "a fixture without sense": (
        put("fixtures", [{"law": "forbidden", "gamma": -1.0}]),
        ["fixtures: ", "session.yaml: fixtures.0: ", "gamma"],
    ),
}
