"""Wires found in whole recordings: synthetic images with their exact wires, PLUS's real ones."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from numpy.typing import NDArray
from typer.testing import CliRunner

from data_synth.phantoms.nwire import NWireSpec, fcal_phantom, nwire_images
from data_synth.scenario.ground_truth import draw_ground_truth
from data_synth.scenario.presets import Preset
from data_synth.ultrasound.probe import SectorProbe
from dvf_ig.calibration import (
    WireImageOptions,
    WireSegmentation,
    calibrate_nwire,
    recording_of,
    segment_wires,
    validate_nwire,
)
from dvf_ig.cli.calibrate.nwire import wire_image_options
from dvf_ig.cli.main import app
from dvf_ig.core import (
    FloatArray,
    InvalidInputError,
    NWireRecording,
    PoseStream,
    QualityGateError,
    Rigid,
    TrackedSequence,
    UnreadableFileError,
)
from dvf_ig.io import (
    phantom_from_probe,
    read_nwire_phantom,
    read_sequence,
    read_wire_points,
    read_wire_search,
    write_nwire_phantom,
    write_sequence,
)


def still(images: NDArray[np.uint8], **fields: object) -> TrackedSequence:
    count = len(images)
    return replace(
        TrackedSequence(np.arange(count, dtype=float), images, np.ones(count, dtype=np.bool_), {}), **fields
    )


@pytest.fixture(scope="module")
def synthetic() -> tuple[NWireRecording, TrackedSequence]:
    """Twenty simulated images with their exact wires."""
    truth = draw_ground_truth(np.zeros(3), SectorProbe().plane_from_image, 150.0, np.random.default_rng(1))
    spec = NWireSpec(frames=20, point_noise_mm=0.0, failed_share=0.0)
    rng = np.random.default_rng(2)
    return nwire_images(truth.probe_from_image, SectorProbe(), Preset().nwire_tracker, spec, rng)


def test_synthetic_images_at_unknown_pixel_size(synthetic: tuple[NWireRecording, TrackedSequence]) -> None:
    truth, sequence = synthetic
    assert sequence.images is not None
    found = segment_wires(still(sequence.images[:8].copy()), truth.phantom)
    assert found.used == 8
    assert found.spacing_mm == pytest.approx(SectorProbe().plane_from_image.scale_mm_per_px[0], rel=0.02)
    # an oblique wire in a beam some millimetres wide is seen off its axis, by its rough pieces
    errors_mm = np.linalg.norm(found.points_px - truth.points_px[:8], axis=2) * found.spacing_mm
    assert np.median(errors_mm) < 0.35
    assert errors_mm.max() < 2.0


def test_a_lost_wire_and_an_invalid_image_are_left_out_for_their_reason(
    synthetic: tuple[NWireRecording, TrackedSequence],
) -> None:
    truth, sequence = synthetic
    assert sequence.images is not None
    images = sequence.images[:3].copy()
    column, row = truth.points_px[1, 4].round().astype(int)
    images[1, row - 4 : row + 5, column - 13 : column + 14] = 0
    options = WireImageOptions(spacing_mm=0.5, clip=(0, 0, images.shape[2], 240))
    found = segment_wires(
        still(images, image_valid=np.array([True, True, False])), truth.phantom, options=options
    )
    assert found.used == 1
    assert set(found.reasons.values()) == {1}
    assert found.reasons["image marked invalid"] == 1
    assert np.isnan(found.points_px[1:]).all()


def test_black_images_are_refused_with_their_count() -> None:
    black = still(np.zeros((4, 60, 80), dtype=np.uint8))
    with pytest.raises(QualityGateError, match="at any pixel size"):
        segment_wires(black, fcal_phantom())
    found = segment_wires(black, fcal_phantom(), options=WireImageOptions(spacing_mm=0.5))
    poses = PoseStream(
        "phantom", "probe", black.t_s, np.tile(np.eye(3), (4, 1, 1)), np.zeros((4, 3)), black.image_valid
    )
    with pytest.raises(QualityGateError, match=r"none of 4 images .*4 too few dots"):
        recording_of(found, fcal_phantom(), poses)
    with pytest.raises(InvalidInputError, match="poses alone"):
        segment_wires(replace(black, images=None), fcal_phantom())


def test_command_without_points_counts_frames_and_reasons(
    synthetic: tuple[NWireRecording, TrackedSequence], tmp_path: Path
) -> None:
    truth, sequence = synthetic
    assert sequence.images is not None
    images = sequence.images.copy()
    images[3] = 0
    probe = truth.phantom_from_probe
    held = PoseStream("reference", "probe", probe.t_s, probe.rotations, probe.translations_mm, probe.valid)
    write_sequence(
        TrackedSequence(probe.t_s, images, sequence.image_valid, {held.name: held}), tmp_path / "n.igs.mha"
    )
    device = tmp_path / "n.xml"
    write_nwire_phantom(device, truth.phantom, Rigid.identity("reference", "phantom"))
    search = '<Segmentation ApproximateSpacingMmPerPixel="0.5" /><PhantomDefinition>'
    device.write_text(device.read_text().replace("<PhantomDefinition>", search))
    arguments = ["calibrate", "probe", str(tmp_path / "n.igs.mha"), "--device-set", str(device)]
    done = CliRunner().invoke(app, [*arguments, "--json", "--picture", str(tmp_path / "n.png")])
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    assert result["segmentation"] == {"frames_used": 19, "frames": 20, "reasons": {"too few dots": 1}}
    assert (tmp_path / "n.png").read_bytes().startswith(b"\x89PNG")


def test_search_settings_come_from_the_device_set(data_dir: Path, tmp_path: Path) -> None:
    device = data_dir / "plus-nwire-segmentation/PlusDeviceSet_iCal_CalibrationOnly_VLCUS_FrameGrabber.xml"
    options = wire_image_options(read_wire_search(device))
    assert (options.spacing_mm, options.clip, options.most) == (0.21, (68, 145, 390, 300), 50)
    assert options.tolerances.collinear_mm == 1.11
    bad = tmp_path / "bad.xml"
    bad.write_text('<PlusConfiguration><Segmentation ApproximateSpacingMmPerPixel="-1"/></PlusConfiguration>')
    with pytest.raises(UnreadableFileError, match="must be positive"):
        read_wire_search(bad)
    bad.write_text("<PlusConfiguration/>")
    assert wire_image_options(read_wire_search(bad)) == WireImageOptions()


def real_wires(folder: Path, name: str) -> tuple[WireSegmentation, NWireRecording]:
    device = folder / "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml"
    path = folder / f"fCal_Test_{name}_3NWires_fCal2.0.igs.mha"
    phantom, sequence = read_nwire_phantom(device), read_sequence(path)
    found = segment_wires(sequence, phantom, options=wire_image_options(read_wire_search(device)))
    return found, recording_of(found, phantom, phantom_from_probe(path, sequence, device))


def test_real_images_calibrate_the_probe(data_dir: Path) -> None:
    folder = data_dir / "plus-fcal20-nwire"
    first, recording = real_wires(folder, "Calibration")
    second, held_out = real_wires(folder, "Validation")
    table = folder / "FreehandCalibration3NWires_fCal2.0.results.xml"
    for found, section in ((first, "CalibrationData"), (second, "ValidationData")):
        theirs = read_wire_points(table, section, recording.phantom, len(found.frames))
        both = np.isfinite(theirs).all(axis=(1, 2)) & np.isfinite(found.points_px).all(axis=(1, 2))
        assert both.sum() >= 0.98 * np.isfinite(theirs).all(axis=(1, 2)).sum()
        error_px = np.linalg.norm((found.points_px - theirs)[both], axis=2)
        within = (error_px < 5).mean()
        print(f"{section}: {found.used} of {len(found.frames)} frames, {within:.4f} within 5 px")  # noqa: T201
        assert within > 0.998
        assert error_px.max() < 10
    calibrated = calibrate_nwire(recording, rng=np.random.default_rng(0))
    checked = validate_nwire(calibrated.probe_from_image, held_out)
    print(f"validation {checked.summary.mean95:.3f} mm over {checked.frames_used} of {checked.frames} frames")  # noqa: T201
    assert checked.frames_used >= 0.98 * checked.frames
    assert checked.summary.mean95 <= 0.60


def test_real_candidates_lie_on_plus_baseline(data_dir: Path) -> None:
    folder = data_dir / "plus-nwire-segmentation"
    name = "SegmentationTest_VLCUS_RandomStepperMotionData2"
    device = folder / "PlusDeviceSet_iCal_CalibrationOnly_VLCUS_FrameGrabber.xml"
    every = 4
    cases = ElementTree.parse(folder / f"{name}_Segmentation_baseline.xml").findall("TestCase")[::every]
    sequence = read_sequence(folder / f"{name}.igs.mha")
    assert sequence.images is not None
    part = still(sequence.images[::every].copy(), orientation=sequence.orientation)
    found = segment_wires(
        part, read_nwire_phantom(device), options=wire_image_options(read_wire_search(device))
    )
    wires, candidates, labelled = [], [], []
    for case, frame in zip(cases, found.frames, strict=True):
        output = case.find("Output")
        assert output is not None
        theirs = np.array([p.attrib["Positon"].split() for p in case.iter("Point")], dtype=float)
        candidates.append(nearest_px(theirs, frame.dots.points_px))
        if output.attrib["SegmentationSuccess"] == "1":
            six = np.array(output.attrib["SegmentationPoints"].split(), dtype=float).reshape(-1, 2)
            wires.append(nearest_px(six, frame.dots.points_px))
            if frame.found is not None:
                labelled.append(np.linalg.norm(six - frame.found.points_px, axis=1))
    of_wires, of_all = (float((np.concatenate(d) < 5).mean()) for d in (wires, candidates))
    print(f"within 5 px of the baseline: {of_wires:.4f} of its wires, {of_all:.4f} of all its candidates")  # noqa: T201
    print(f"wires found in {found.used} of {len(part)} frames, left out: {found.reasons}")  # noqa: T201
    assert of_wires >= 0.99
    assert of_all >= 0.93  # the others are its artefacts on the transducer's face
    assert found.used >= 0.98 * len(part)
    assert (np.concatenate(labelled) < 5).mean() >= 0.99


def nearest_px(points: FloatArray, dots: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(points[:, None] - dots[None], axis=2).min(axis=1))
