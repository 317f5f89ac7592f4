"""Wires found in images: planted dots and planes, synthetic recordings, PLUS's real ones."""

import json
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

from data_synth.nwire import NWireSpec, fcal_phantom, nwire_images, wire_crossings_px
from data_synth.planting import plant
from data_synth.presets import Preset
from data_synth.ultrasound_probe import SectorProbe
from dvf_ig.calibration import (
    Dots,
    FoundWires,
    RefusedFrame,
    Rejection,
    WireImageOptions,
    WireSegmentation,
    calibrate_probe,
    find_dots,
    find_wires,
    plan_wires,
    recording_of,
    segment_wires,
    validate_probe,
)
from dvf_ig.cli.main import app
from dvf_ig.core import (
    FloatArray,
    InvalidInputError,
    NWirePhantom,
    NWireRecording,
    PoseStream,
    QualityGateError,
    Rigid,
    TrackedSequence,
    UnreadableFileError,
    Wire,
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

SPACING = 0.078
PIXEL_MM = np.array([0.081, 0.075])
CENTER_PX = np.array([400.0, 300.0])


def blobs(
    points: FloatArray, sd_px: tuple[float, float], shape: tuple[int, int], peak: float = 200.0
) -> NDArray[np.uint8]:
    """Gaussian dots, SD along columns and rows, on black."""
    row, column = np.mgrid[: shape[0], : shape[1]]
    image = np.zeros(shape)
    for x, y in points:
        image += peak * np.exp(-0.5 * (((column - x) / sd_px[0]) ** 2 + ((row - y) / sd_px[1]) ** 2))
    return np.clip(np.round(image), 0, 255).astype(np.uint8)


def crossings(tilt_rad: FloatArray, shift_mm: FloatArray, phantom: NWirePhantom) -> FloatArray:
    """(wires, 2) px where an image plane, so many radians off across the wires, meets them."""
    facing = Rotation.from_matrix([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]])
    rotation = (facing * Rotation.from_rotvec(tilt_rad)).as_matrix()
    phantom_from_image = np.eye(4)
    phantom_from_image[:3, :3] = rotation * [*PIXEL_MM, 1.0]
    middle = np.array([45.0, 20.0, 10.0]) + shift_mm
    phantom_from_image[:3, 3] = middle - phantom_from_image[:3, :2] @ CENTER_PX
    return wire_crossings_px(phantom, phantom_from_image)[0]


def square_phantom() -> NWirePhantom:
    """Two patterns whose outer wires form a rectangle: no image can tell its ends apart."""
    rows = [
        (
            Wire(f"a{z}", np.array([0.0, 0, z]), np.array([0.0, 40, z])),
            Wire(f"b{z}", np.array([a, 0.0, z]), np.array([b, 40.0, z])),
            Wire(f"c{z}", np.array([30.0, 0, z]), np.array([30.0, 40, z])),
        )
        for z, a, b in ((0.0, 5.0, 25.0), (-15.0, 25.0, 5.0))
    ]
    return NWirePhantom(tuple(rows))


def still(images: NDArray[np.uint8], **fields: object) -> TrackedSequence:
    count = len(images)
    return replace(
        TrackedSequence(np.arange(count, dtype=float), images, np.ones(count, dtype=np.bool_), {}), **fields
    )  # type: ignore[arg-type]


@pytest.mark.parametrize("spacing", [0.08, 0.5])
def test_dots_lie_where_they_were_planted(spacing: float) -> None:
    points = np.array([[60.3, 50.8], [150.6, 41.2], [100.2, 120.7]])
    sd_px = (max(2.0, 0.7 / spacing), max(1.5, 0.3 / spacing))
    found = find_dots(blobs(points, sd_px, (170, 220)), spacing)
    assert len(found) == 3
    nearest = np.linalg.norm(points[:, None] - found.points_px[None], axis=2).min(axis=1)
    assert nearest.max() < 0.1
    clipped = find_dots(blobs(points, sd_px, (170, 220)), spacing, clip=(20, 15, 180, 75))
    assert sorted(clipped.points_px[:, 0].round().tolist()) == [60.0, 151.0]


def test_two_echoes_that_touch_keep_their_own_centres() -> None:
    points = np.array([[60.0, 60.0], [74.0, 62.0]])
    found = find_dots(blobs(points, (5.0, 2.5), (120, 140)), 0.3)
    assert len(found) == 2
    nearest = np.linalg.norm(points[:, None] - found.points_px[None], axis=2).min(axis=1)
    assert nearest.max() < 1.0


def test_a_clip_outside_the_image_and_a_pixel_without_size_are_refused() -> None:
    with pytest.raises(InvalidInputError, match="must lie in the image of 60 x 50 px"):
        find_dots(np.zeros((50, 60), dtype=np.uint8), 0.1, clip=(20, 0, 50, 50))
    with pytest.raises(InvalidInputError, match="must be positive"):
        find_dots(np.zeros((50, 60), dtype=np.uint8), 0.0)


@settings(max_examples=25)
@given(seed=st.integers(0, 10**6), across=st.sampled_from([1, -1]), down=st.sampled_from([1, -1]))
def test_wires_of_any_tilted_plane_are_named_right(seed: int, across: int, down: int) -> None:
    rng = np.random.default_rng(seed)
    wires = crossings(rng.uniform(-0.3, 0.3, 3), rng.uniform((-3, -3, -3), (3, 3, 3)), fcal_phantom())
    # an image may be stored mirrored either way; three stray dots, dimmer than the wires
    wires = CENTER_PX + (wires - CENTER_PX) * (across, down)
    stray = CENTER_PX + rng.uniform(-250, 250, (3, 2))
    order = rng.permutation(12)
    dots = Dots(np.vstack([wires, stray])[order], np.repeat([20.0, 4.0], [9, 3])[order])
    found = find_wires(dots, plan_wires(fcal_phantom()), SPACING)
    assert isinstance(found, FoundWires)
    assert np.array_equal(found.points_px, wires)
    assert found.labelling == (-across, down)
    assert found.misfit_mm < 0.6  # pixels that are not square, taken as square


def test_outer_wires_that_look_alike_are_named_by_the_orientation() -> None:
    phantom = square_phantom()
    wires = CENTER_PX + (crossings(np.zeros(3), np.zeros(3), phantom) - CENTER_PX) * 1.0
    dots = Dots(wires, np.full(6, 20.0))
    for orientation, first_is_right in (("MFA", True), ("UFA", False), ("XX", True)):
        plan = plan_wires(phantom, orientation)
        assert len(plan.labellings) == 1
        found = find_wires(dots, plan, SPACING)
        assert isinstance(found, FoundWires)
        assert (found.points_px[0, 0] > found.points_px[2, 0]) == first_is_right
        assert found.points_px[0, 1] < found.points_px[3, 1]
    upside_down = find_wires(dots, plan_wires(phantom, "MN"), SPACING)
    assert isinstance(upside_down, FoundWires)
    assert upside_down.points_px[0, 1] > upside_down.points_px[3, 1]


def refusal(points: FloatArray) -> RefusedFrame:
    found = find_wires(Dots(points, np.full(len(points), 20.0)), plan_wires(fcal_phantom()), SPACING)
    assert isinstance(found, RefusedFrame)
    return found


def test_every_refusal_says_what_was_seen() -> None:
    wires = crossings(np.zeros(3), np.zeros(3), fcal_phantom())
    few = refusal(wires[:6])
    assert few.reason is Rejection.TOO_FEW_DOTS
    assert few.detail == "9 wires expected, 6 dots found on 2 lines"
    corner = np.random.default_rng(0).uniform(0, 40, (12, 2))
    assert refusal(corner) == RefusedFrame(Rejection.NO_LINE, "no line of three dots among 12")
    aside = np.array([[790.0, 590], [792, 560], [788, 540]])
    apart = refusal(np.vstack([wires[:6], aside]))
    assert apart == RefusedFrame(Rejection.LINES_APART, "3 lines expected, 9 dots form 2 lines")
    far = wires.copy()
    far[6:, 1] += 4.0 / SPACING
    assert refusal(far).reason is Rejection.LINES_APART
    bent = wires.copy()
    bent[[0, 8], 0] += [2.4 / SPACING, 2.4 / SPACING]
    assert refusal(bent).reason is Rejection.MISFIT
    slid = wires.copy()
    # met 2, 20 and 38 mm along the wires, 10 mm below each other
    slid[[1, 4, 7], 0] = CENTER_PX[0] + np.array([9.0, 0.0, -4.25]) / PIXEL_MM[0]
    assert refusal(slid).reason is Rejection.STEEP


def test_phantoms_that_give_no_plan_are_refused() -> None:
    patterns = fcal_phantom().patterns
    with pytest.raises(InvalidInputError, match="at least two"):
        plan_wires(NWirePhantom(patterns[:1]))
    with pytest.raises(InvalidInputError, match="lie in one plane"):
        plan_wires(NWirePhantom((patterns[0], patterns[0])))
    turned = Rotation.from_rotvec([0, 0, 0.1]).as_matrix()
    skew = tuple(Wire(w.name, turned @ w.front_mm, turned @ w.back_mm) for w in patterns[1])
    with pytest.raises(InvalidInputError, match="from parallel"):
        plan_wires(NWirePhantom((patterns[0], (skew[0], skew[1], skew[2]))))


@pytest.fixture(scope="module")
def synthetic() -> tuple[NWireRecording, TrackedSequence]:
    """Twenty simulated images with their exact wires."""
    planted = plant(np.zeros(3), SectorProbe().plane_from_image, 150.0, np.random.default_rng(1))
    spec = NWireSpec(frames=20, point_noise_mm=0.0, failed_share=0.0)
    rng = np.random.default_rng(2)
    return nwire_images(planted.probe_from_image, SectorProbe(), Preset().nwire_tracker, spec, rng)


def test_synthetic_images_at_unknown_pixel_size(
    synthetic: tuple[NWireRecording, TrackedSequence],
) -> None:
    truth, sequence = synthetic
    assert sequence.images is not None
    found = segment_wires(still(sequence.images[:8].copy()), truth.phantom)
    assert found.used == 8
    assert found.spacing_mm == pytest.approx(SectorProbe().plane_from_image.scale_mm_per_px[0], rel=0.02)
    # an oblique wire in a beam some millimetres wide is seen off its axis, by its rough pieces
    misses_mm = np.linalg.norm(found.points_px - truth.points_px[:8], axis=2) * found.spacing_mm
    assert np.median(misses_mm) < 0.35
    assert misses_mm.max() < 2.0


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
    options = read_wire_search(
        data_dir / "plus-nwire-segmentation/PlusDeviceSet_iCal_CalibrationOnly_VLCUS_FrameGrabber.xml"
    )
    assert (options.spacing_mm, options.clip, options.dots.most) == (0.21, (68, 145, 390, 300), 50)
    assert options.pattern.lines.collinear_mm == 1.11
    bad = tmp_path / "bad.xml"
    bad.write_text('<PlusConfiguration><Segmentation ApproximateSpacingMmPerPixel="-1"/></PlusConfiguration>')
    with pytest.raises(UnreadableFileError, match="must be positive"):
        read_wire_search(bad)
    bad.write_text("<PlusConfiguration/>")
    assert read_wire_search(bad) == WireImageOptions()


def real_wires(folder: Path, name: str) -> tuple[WireSegmentation, NWireRecording]:
    device = folder / "PlusDeviceSet_fCal_Sim_SpatialCalibration_2.0.xml"
    path = folder / f"fCal_Test_{name}_3NWires_fCal2.0.igs.mha"
    phantom, sequence = read_nwire_phantom(device), read_sequence(path)
    found = segment_wires(sequence, phantom, options=read_wire_search(device))
    return found, recording_of(found, phantom, phantom_from_probe(path, sequence, device))


def test_real_images_calibrate_the_probe(data_dir: Path) -> None:
    folder = data_dir / "plus-fcal20-nwire"
    first, recording = real_wires(folder, "Calibration")
    second, held_out = real_wires(folder, "Validation")
    table = folder / "FreehandCalibration3NWires_fCal2.0.results.xml"
    for found, section in ((first, "CalibrationData"), (second, "ValidationData")):
        theirs = read_wire_points(table, section, recording.phantom, len(found.frames))  # type: ignore[arg-type]
        both = np.isfinite(theirs).all(axis=(1, 2)) & np.isfinite(found.points_px).all(axis=(1, 2))
        assert both.sum() >= 0.98 * np.isfinite(theirs).all(axis=(1, 2)).sum()
        misses = np.linalg.norm((found.points_px - theirs)[both], axis=2)
        print(f"{section}: {found.used} of {len(found.frames)} frames, {(misses < 5).mean():.4f} within 5 px")  # noqa: T201
        assert (misses < 5).mean() > 0.998
        assert misses.max() < 10
    calibrated = calibrate_probe(recording, rng=np.random.default_rng(0))
    checked = validate_probe(calibrated.probe_from_image, held_out)
    print(f"validation {checked.mean95_mm:.3f} mm over {checked.frames_used} of {checked.frames} frames")  # noqa: T201
    assert checked.frames_used >= 0.98 * checked.frames
    assert checked.mean95_mm <= 0.60


def test_real_candidates_lie_on_plus_baseline(data_dir: Path) -> None:
    folder = data_dir / "plus-nwire-segmentation"
    name = "SegmentationTest_VLCUS_RandomStepperMotionData2"
    device = folder / "PlusDeviceSet_iCal_CalibrationOnly_VLCUS_FrameGrabber.xml"
    every = 4
    cases = ElementTree.parse(folder / f"{name}_Segmentation_baseline.xml").findall("TestCase")[::every]
    sequence = read_sequence(folder / f"{name}.igs.mha")
    assert sequence.images is not None
    part = still(sequence.images[::every].copy(), orientation=sequence.orientation)
    found = segment_wires(part, read_nwire_phantom(device), options=read_wire_search(device))
    wires, candidates, labelled = [], [], []
    for case, frame in zip(cases, found.frames, strict=True):
        output = case.find("Output")
        assert output is not None
        rivals = np.array([p.attrib["Positon"].split() for p in case.iter("Point")], dtype=float)
        candidates.append(misses_px(rivals, frame.dots.points_px))
        if output.attrib["SegmentationSuccess"] == "1":
            six = np.array(output.attrib["SegmentationPoints"].split(), dtype=float).reshape(-1, 2)
            wires.append(misses_px(six, frame.dots.points_px))
            if frame.found is not None:
                labelled.append(np.linalg.norm(six - frame.found.points_px, axis=1))
    of_wires, of_all = (float((np.concatenate(d) < 5).mean()) for d in (wires, candidates))
    print(f"within 5 px of the baseline: {of_wires:.4f} of its wires, {of_all:.4f} of all its candidates")  # noqa: T201
    print(f"wires found in {found.used} of {len(part)} frames, left out: {found.reasons}")  # noqa: T201
    assert of_wires >= 0.99
    assert of_all >= 0.93  # the others are its artefacts on the transducer's face
    assert found.used >= 0.98 * len(part)
    assert (np.concatenate(labelled) < 5).mean() >= 0.99


def misses_px(points: FloatArray, dots: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(points[:, None] - dots[None], axis=2).min(axis=1))
