"""Files that were each read without complaint, and cannot be of one intervention, or hardly."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from config_runs import errors, run, write
from toy_lab import SECONDS, SESSION, poses
from toy_sphere import sphere
from wrongly_prepared import CASES as WRONGLY_PREPARED
from wrongly_prepared import blood, in_sequence

from dvf_ig.core import (
    CycleTiming,
    FloatArray,
    Grid,
    Landmarks,
    Mesh,
    Points,
    PoseStream,
    Rigid,
    SurfaceSeries,
    UnreadableFileError,
    VolumeSeries,
)
from dvf_ig.intake import read_session
from dvf_ig.intake.ecg_delay import speed_between
from dvf_ig.intake.findings import Disagreement
from dvf_ig.intake.fit import fit_of
from dvf_ig.intake.heart_in_images import heart_speed
from dvf_ig.intake.parts import SessionFiles
from dvf_ig.io import write_poses, write_surface_series

Change = Callable[[SessionFiles], SessionFiles]


@pytest.fixture(scope="module")
def parts(files: Path) -> SessionFiles:
    path = files / "agreeing.yaml"
    path.write_text(json.dumps(SESSION))
    return replace(read_session(path), named={})


def heart_of(length_mm: float) -> Change:
    def change(parts: SessionFiles) -> SessionFiles:
        assert parts.preop is not None
        assert parts.preop.model is not None
        surface = Mesh("mr", length_mm * np.eye(3), np.array([[0, 1, 2]]))
        model = replace(parts.preop.model, reference=(surface,) * parts.preop.model.phases)
        return replace(parts, preop=replace(parts.preop, model=model))

    return change


def labels_of(length_mm: float) -> Change:
    """An organ of ten voxels along each axis among others that are none, and of nine in its second phase."""
    values = np.ones((2, 20, 20, 20), np.uint8)
    values[:, 5:15, 5:15, 5:15] = 7
    values[1, 14] = 1
    grid = Grid.axis_aligned("mr", (20, 20, 20), [0.0] * 3, length_mm / 10)
    series = VolumeSeries(grid, values, CycleTiming.uniform(2, 0.8))

    def change(parts: SessionFiles) -> SessionFiles:
        assert parts.preop is not None
        preop = replace(parts.preop.preop, labels=series, organ_labels=(7,))
        return replace(parts, preop=replace(parts.preop, preop=preop, model=None))

    return change


def absent_label(parts: SessionFiles) -> SessionFiles:
    changed = labels_of(100.0)(parts)
    assert changed.preop is not None
    preop = replace(changed.preop.preop, organ_labels=(7, 99))
    return replace(changed, preop=replace(changed.preop, preop=preop))


def mr_is_labels(parts: SessionFiles) -> SessionFiles:
    changed = labels_of(100.0)(parts)
    assert changed.preop is not None
    preop = replace(changed.preop.preop, mr=changed.preop.preop.labels)
    return replace(changed, preop=replace(changed.preop, preop=preop))


def moved(stream: PoseStream, factor: float = 1.0, by_mm: float = 0.0) -> PoseStream:
    return replace(stream, translations_mm=factor * stream.translations_mm + by_mm)


def tool(factor: float = 1.0, by_mm: float = 0.0) -> Change:
    def change(parts: SessionFiles) -> SessionFiles:
        assert parts.tool is not None
        return replace(parts, tool=moved(parts.tool, factor, by_mm))

    return change


def still(parts: SessionFiles) -> SessionFiles:
    assert parts.tool is not None
    held = np.repeat(parts.tool.translations_mm[:1], len(parts.tool), axis=0)
    return replace(parts, tool=replace(parts.tool, translations_mm=held))


def tool_is(name: str) -> Change:
    def change(parts: SessionFiles) -> SessionFiles:
        assert parts.sweep is not None
        assert parts.tool is not None
        if name == "probe":
            return replace(parts, tool=parts.sweep.probe)
        return replace(parts, tip=replace(parts.tool, t_s=parts.tool.t_s))

    return change


def exchanged(parts: SessionFiles) -> SessionFiles:
    """Images by the tool's poses, which never bring them to the heart, and the tool by the probe's."""
    parts = heart_of(90.0)(parts)
    assert parts.sweep is not None
    away = moved(poses("needle", 0.5, SECONDS - 1, 20.0), by_mm=-70.0)
    return replace(parts, sweep=replace(parts.sweep, probe=away), tool=parts.sweep.probe)


def probe(factor: float) -> Change:
    def change(parts: SessionFiles) -> SessionFiles:
        assert parts.sweep is not None
        return replace(parts, sweep=replace(parts.sweep, probe=moved(parts.sweep.probe, factor)))

    return change


def milliseconds(parts: SessionFiles) -> SessionFiles:
    assert parts.tool is not None
    return replace(parts, tool=replace(parts.tool, t_s=1000.0 * parts.tool.t_s))


def tip(*xyz_mm: float) -> Change:
    return lambda parts: replace(parts, tip=Points("tool", np.array([xyz_mm])))


def recorded_map(parts: SessionFiles) -> SessionFiles:
    """The recording holds the calibration in use, its columns the other way round."""
    assert parts.sweep is not None
    mirrored = parts.probe.matrix @ np.diag([-1.0, 1.0, 1.0, 1.0])  # type: ignore[union-attr]
    maps = {f"{parts.sweep.probe.source}_from_image": mirrored}
    recorded = replace(parts.sweep.recorded, image_maps=maps)
    return replace(parts, sweep=replace(parts.sweep, recorded=recorded))


def image_moved(parts: SessionFiles) -> SessionFiles:
    far = replace(parts.probe.rigid, translation_mm=np.array([0.0, 0.0, -400.0]))  # type: ignore[union-attr]
    return replace(parts, probe=replace(parts.probe, rigid=far))  # type: ignore[type-var]


def start_at(z_mm: float) -> Change:
    pose = Rigid("mr", "tracker", np.eye(3), np.array([0.0, 0.0, z_mm]))
    return lambda parts: replace(parts, start=replace(parts.start, start=pose))


def landmarks(by_mm: float) -> Change:
    def change(parts: SessionFiles) -> SessionFiles:
        marked = parts.start.landmarks_mr
        assert marked is not None
        there = Landmarks(marked.names, Points("mr", marked.points.xyz_mm + by_mm))
        return replace(parts, start=replace(parts.start, landmarks_mr=there))

    return change


def another_heart(parts: SessionFiles) -> SessionFiles:
    """A ball of many vertices, which the landmarks are nowhere near."""
    assert parts.preop is not None
    assert parts.preop.model is not None
    directions = np.random.default_rng(3).normal(size=(200, 3))
    ball = 45.0 * directions / np.linalg.norm(directions, axis=1, keepdims=True)
    mesh = Mesh("mr", ball, np.array([[0, 1, 2]]))
    model = replace(parts.preop.model, reference=(mesh,) * parts.preop.model.phases)
    return replace(parts, preop=replace(parts.preop, model=model))


def swept(parts: SessionFiles) -> SessionFiles:
    """A probe whose speed changes, and images that follow it at the latency of the other sign."""
    assert parts.sweep is not None
    assert isinstance(parts.latency, float)

    def x_mm(t_s: FloatArray) -> FloatArray:
        return np.asarray(15.0 * t_s + 4.0 * np.sin(1.7 * t_s) + np.sin(5.1 * t_s))

    probe, t_s = parts.sweep.probe, parts.sweep.recorded.t_s
    shifts_mm = np.column_stack([x_mm(probe.t_s), np.zeros((len(probe), 2))])
    images = textures(0.1 * x_mm(t_s - parts.latency), 0.1)
    moving = replace(probe, translations_mm=shifts_mm)
    return replace(
        parts, sweep=replace(parts.sweep, probe=moving, recorded=replace(parts.sweep.recorded, images=images))
    )


def same_landmarks(parts: SessionFiles) -> SessionFiles:
    marked = parts.start.landmarks_mr
    assert marked is not None
    touched = Landmarks(marked.names, Points("tracker", marked.points.xyz_mm))
    return replace(parts, start=replace(parts.start, landmarks_tracker=touched))


def slow_heart(parts: SessionFiles) -> SessionFiles:
    assert parts.preop is not None
    assert parts.preop.model is not None
    slow = replace(parts.preop.model, timing=replace(parts.preop.model.timing, rr_s=2.4))
    return replace(parts, preop=replace(parts.preop, model=slow))


def short_ecg(parts: SessionFiles) -> SessionFiles:
    return replace(parts, ecg=replace(parts.ecg, samples=parts.ecg.samples[:1100]))  # type: ignore[union-attr,type-var]


def beating(late_s: float = 0.0, drift: float = 0.0, noise: float = 0.0, beats: int | None = None) -> Change:
    """Images that change as fast as the model moves, by an ECG that is late, or whose clock runs too fast.

    Args:
        beats: seed of beats of their own, 0.8 s long on average, in place of the ECG's.
    """
    sizes = np.array([1.0, 0.8, 0.85, 0.95])

    def change(parts: SessionFiles) -> SessionFiles:
        assert parts.preop is not None
        assert parts.preop.model is not None
        assert parts.sweep is not None
        model = parts.preop.model
        meshes = tuple(Mesh("mr", 70.0 * s * np.eye(3), np.array([[0, 1, 2]])) for s in sizes)
        moving = replace(model, reference=meshes)
        amounts = np.abs(np.roll(sizes, -1) - sizes)
        at = (parts.sweep.recorded.t_s - 0.065 - late_s) * (1.0 + drift) / 0.8
        if beats is not None:
            lengths = np.random.default_rng(beats).normal(1.0, 0.08, 30)
            at = np.interp(at, np.cumsum(lengths) - lengths[0], np.arange(30.0))
        way = np.interp(at - 0.05, *unrolled(amounts, model.timing.fractions - 0.05))
        return replace(
            parts,
            preop=replace(parts.preop, model=moving),
            sweep=replace(
                parts.sweep, recorded=replace(parts.sweep.recorded, images=textures(8.0 * way, noise))
            ),
        )

    return change


def unrolled(amounts: FloatArray, fractions: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Times in cycles, and the way made until each, over twenty cycles."""
    at = np.concatenate([k + fractions for k in range(-2, 18)])
    return at, np.concatenate([[0.0], np.cumsum(np.tile(amounts, 20))[:-1]])


def textures(way: FloatArray, noise: float) -> np.ndarray[Any, np.dtype[np.uint8]]:
    """(n, 80, 60) grey levels that change with a way that is made."""
    rng = np.random.default_rng(4)
    first, second = rng.normal(size=(2, 14, 10))
    mixed = np.cos(way)[:, None, None] * first + np.sin(way)[:, None, None] * second
    mixed += noise * rng.normal(size=mixed.shape)
    grey = np.repeat(np.repeat(mixed, 6, axis=1), 6, axis=2)[:, :80, :60]
    return np.clip(128 + 30 * grey, 1, 255).astype(np.uint8)


CASES: dict[str, tuple[Change, Disagreement, str]] = {
    "a heart in m": (heart_of(0.09), Disagreement.HEART_NOT_IN_MM, "preop.model"),
    "a heart in cm": (heart_of(11.0), Disagreement.HEART_NOT_IN_MM, "preop.model"),
    "a heart in µm": (heart_of(9e4), Disagreement.HEART_NOT_IN_MM, "preop.model"),
    "labels of a voxel size in cm": (labels_of(9.0), Disagreement.HEART_NOT_IN_MM, "preop.labels"),
    "a child's heart": (heart_of(45.0), Disagreement.HEART_OF_UNUSUAL_SIZE, "preop.model"),
    "more than a heart": (labels_of(260.0), Disagreement.HEART_OF_UNUSUAL_SIZE, "preop.labels"),
    "surfaces of somebody else": (
        lambda parts: replace(parts, preop=replace(parts.preop, named_patient="P-18")),  # type: ignore[type-var]
        Disagreement.OTHER_PATIENT,
        "preop.surfaces_folder",
    ),
    "labels as grey levels": (mr_is_labels, Disagreement.MR_IS_LABELS, "preop.mr"),
    "a tool in m": (tool(1e-3), Disagreement.POSES_NOT_IN_MM, "tool"),
    "a tool in µm": (tool(1e3), Disagreement.POSES_OUT_OF_REACH, "tool"),
    "a tool that lies still": (still, Disagreement.TOOL_STILL, "tool"),
    "a tool of another tracker": (tool(by_mm=900.0), Disagreement.TOOL_OFF_HEART, "tool"),
    "a tool away from the heart": (tool(by_mm=150.0), Disagreement.TOOL_FAR_FROM_HEART, "tool"),
    "the probe as tool": (tool_is("probe"), Disagreement.TOOL_IS_PROBE, "tool"),
    "probe and tool exchanged": (exchanged, Disagreement.PROBE_AND_TOOL_EXCHANGED, "ultrasound.probe_name"),
    "the pivoting as tool": (tool_is("pivot"), Disagreement.TOOL_IS_PIVOT, "tool"),
    "a tool's stamps in ms": (milliseconds, Disagreement.STAMPS_NOT_IN_S, "tool"),
    "a probe in m": (probe(1e-3), Disagreement.POSES_NOT_IN_MM, "ultrasound"),
    "a tip in µm": (tip(0.0, 0.0, 1.5e5), Disagreement.TIP_OUT_OF_REACH, "calibration.tip"),
    "a tip in m": (tip(0.0, 0.0, 0.15), Disagreement.TIP_NOT_IN_MM, "calibration.tip"),
    "a tip near its marker": (tip(0.0, 0.0, 1.5), Disagreement.TIP_NEAR_MARKER, "calibration.tip"),
    "an image far from its probe": (image_moved, Disagreement.IMAGE_FAR_FROM_PROBE, "calibration.probe"),
    "another calibration in the recording": (recorded_map, Disagreement.OTHER_IMAGE_MAP, "calibration.probe"),
    "a start of another day": (start_at(-700.0), Disagreement.IMAGES_OFF_HEART, "start.transform"),
    "landmarks of another heart": (landmarks(900.0), Disagreement.LANDMARKS_OFF_HEART, "start.landmarks_mr"),
    "landmarks of another patient": (
        another_heart,
        Disagreement.LANDMARKS_BESIDE_HEART,
        "start.landmarks_mr",
    ),
    "a label that is not there": (absent_label, Disagreement.LABELS_ABSENT, "preop.labels"),
    "one set of landmarks": (same_landmarks, Disagreement.LANDMARKS_ARE_THE_SAME, "start.landmarks_tracker"),
    "a rate three times too high": (slow_heart, Disagreement.ECG_OF_ANOTHER_RATE, "ecg"),
    "an ECG that is late": (beating(-0.3), Disagreement.ECG_LATE, "ecg"),
    "an ECG that may be late": (beating(-0.3, noise=0.7), Disagreement.ECG_PERHAPS_LATE, "ecg"),
    "an ECG whose clock drifts": (beating(-0.154, drift=-0.02, noise=0.45), Disagreement.ECG_DRIFTS, "ecg"),
    "an ECG of another sampling rate": (beating(-0.154, drift=-0.025), Disagreement.ECG_CLOCK_WRONG, "ecg"),
    "an ECG of another recording": (beating(beats=1), Disagreement.ECG_OF_ANOTHER_RECORDING, "ecg"),
    "a latency of the wrong sign": (
        lambda parts: replace(beating()(parts), latency=0.065),
        Disagreement.LATENCY_SIGN,
        "calibration.latency",
    ),
    "a latency of the wrong sign, by the probe": (
        swept,
        Disagreement.LATENCY_SIGN_UNLIKELY,
        "calibration.latency",
    ),
    "a cine that begins late": (
        in_sequence(blood(20.0, 26.0, 25.0, 22.0), beating(-0.2)),
        Disagreement.CINE_ORDER,
        "preop.model",
    ),
    **WRONGLY_PREPARED,
    "an ECG that was cut off": (short_ecg, Disagreement.LITTLE_COMMON_TIME, "ecg"),
}


def test_files_that_agree(parts: SessionFiles) -> None:
    fit = fit_of(parts)
    assert (fit.misfits, fit.warnings) == ((), ())


@pytest.mark.parametrize("case", CASES)
def test_what_does_not_agree_is_refused_or_told(parts: SessionFiles, case: str) -> None:
    change, cause, key = CASES[case]
    fit = fit_of(change(parts))
    told = [(one.key, one.sentence) for one in fit.misfits]
    told += [(one.key, one.sentence) for one in fit.warnings]
    first_words = cause.value.sentence.split("{", maxsplit=1)[0]
    assert any(where == key and first_words in sentence for where, sentence in told), told
    named = [problem for problem in fit.misfits if first_words in problem.sentence]
    assert bool(named) is cause.value.refused
    assert cause.value.refused or {one.cause for one in fit.warnings if one.key == key} == {cause}


@pytest.mark.parametrize("late_s", [-0.3, -0.2, 0.0, 0.04, 0.2])
def test_images_tell_how_late_the_ecg_is(parts: SessionFiles, late_s: float) -> None:
    seen = fit_of(beating(-late_s)(parts)).seen
    assert seen is not None
    assert seen.delay.known
    assert seen.delay.delay_s == pytest.approx(late_s, abs=0.04)
    assert seen.delay.suspicious is (abs(late_s) > 0.08)
    assert seen.drift_s == pytest.approx(0.0, abs=0.04)


def test_a_heart_s_speed_is_known_where_its_vertices_do_not_correspond(parts: SessionFiles) -> None:
    assert parts.preop is not None
    assert parts.preop.model is not None
    radii_mm = np.array([40.0, 32.0, 34.0, 38.0])
    meshes = []
    for k, radius_mm in enumerate(radii_mm):
        meshes.append(Mesh("mr", *sphere(radius_mm, 3 + k % 2)))
    model = replace(parts.preop.model, reference=tuple(meshes), reference_caps=caps_of(meshes))
    found = heart_speed(replace(parts.preop, model=model))
    assert found is not None
    true = speed_between(np.abs(np.roll(radii_mm, -1) - radii_mm), model.timing.fractions)
    assert found.speed == pytest.approx(true.speed, rel=0.15)


def caps_of(meshes: list[Mesh]) -> tuple[np.ndarray[Any, np.dtype[np.bool_]], ...]:
    return tuple(np.zeros(len(mesh.triangles), dtype=np.bool_) for mesh in meshes)


def test_images_that_do_not_beat_say_nothing(parts: SessionFiles) -> None:
    still = beating()(parts)
    assert still.sweep is not None
    noise = np.random.default_rng(5).integers(1, 255, still.sweep.recorded.images.shape, np.uint8)  # type: ignore[union-attr]
    recorded = replace(still.sweep.recorded, images=noise)
    fit = fit_of(replace(still, sweep=replace(still.sweep, recorded=recorded)))
    assert fit.findings == ()
    assert fit.seen is not None
    assert fit.seen.sentence.startswith("not known: ")
    assert fit.seen.values() == {"delay_s": None, "drift_s": None, "log_likelihood_ratio": None}
    without_latency = fit_of(replace(beating()(parts), latency=None))
    assert without_latency.seen is None


def test_names_of_surfaces_tell_their_patient(lab: Path, beating_sphere: SurfaceSeries) -> None:
    scale = 80.0 / float(np.ptp(beating_sphere.vertices_mm[0], axis=0).max())
    sized = replace(beating_sphere, vertices_mm=scale * beating_sphere.vertices_mm)
    write_surface_series(sized, lab / "surfaces")
    for path in (lab / "surfaces").glob("*.vtp"):
        path.rename(path.with_name(f"P-18_{path.name}"))
    name = beating_sphere.name
    preop = {"surfaces_folder": "surfaces", "surfaces": [name], "surface": name}
    read = read_session(write(lab, {**SESSION, "patient_id": "P-17", "preop": preop}))
    assert read.scenario.preop.surfaces[0].patient_id == "P-17"
    assert Disagreement.OTHER_PATIENT in {one.cause for one in fit_of(read).warnings}
    read = read_session(write(lab, {**SESSION, "patient_id": "P-18", "preop": preop}))
    assert Disagreement.OTHER_PATIENT not in {one.cause for one in fit_of(read).warnings}


@pytest.mark.parametrize(
    ("changes", "advice"),
    [
        ({"calibration": {"latency": "0.035 s"}}, "a number is written without quotes and unit"),
        ({"ecg": "csv:day\\\\ecg.csv"}, "write / for"),
        ({"preop": {"labels": "C:\temp\new.nrrd"}}, r"C:.temp.new\.nrrd .*write / for"),
        ({"preop": {"labels": "~/ed.nrrd"}}, "write out ~, your home"),
    ],
)
def test_a_name_that_is_no_file_is_missing_with_advice(
    lab: Path, changes: dict[str, Any], advice: str
) -> None:
    with pytest.raises(UnreadableFileError, match=advice):
        read_session(write(lab, {**SESSION, **changes}))


def test_every_disagreement_has_its_case() -> None:
    of_a_live_record = {
        Disagreement.RECORD_ENDS_EARLY,
        Disagreement.RECORD_LACKS_MESSAGES,
    }  # tests/live/test_record.py
    assert {cause for _, cause, _ in CASES.values()} == set(Disagreement) - of_a_live_record


WAYS = {
    "tool and probe exchanged": ("probe and tool exchanged", "the probe as tool"),
    "another patient's model": ("another patient's model",),
    "a foreign ECG of the same rate": ("an ECG of another recording",),
    "names of landmarks exchanged": ("names of landmarks exchanged",),
    "metres": ("a heart in m", "a tool in m", "a probe in m", "a tip in m", "landmarks in m"),
    "inverse transforms": ("the start's inverse", "the poses' inverses", "the probe calibration's inverse"),
    "the wrong sign of the latency": ("a latency of the wrong sign",),
    "another day's start": ("a start of another day",),
    "RAS in place of LPS": ("a start in RAS",),
    "another order of the cine's phases": ("a cine that begins late", "grey levels of another phase order"),
}


@pytest.mark.parametrize("way", WAYS)
def test_a_session_prepared_wrongly_is_refused_by_its_cause(parts: SessionFiles, way: str) -> None:
    """No registration begins, so that none can end in force; what comes first is the cause itself."""
    for case in WAYS[way]:
        change, cause, _ = CASES[case]
        assert cause.value.refused
        first = fit_of(change(parts)).misfits[0]
        assert cause.value.sentence.split("{", maxsplit=1)[0] in first.sentence


def test_a_foreign_ecg_stays_foreign_however_it_is_shifted(parts: SessionFiles) -> None:
    """To obey "it is late" must not turn the run green."""
    for late_s in (0.0, 0.4):
        causes = {one.cause for one in fit_of(beating(float(late_s), beats=1)(parts)).findings}
        assert Disagreement.ECG_OF_ANOTHER_RECORDING in causes


def test_a_user_reads_file_and_key(lab: Path) -> None:
    write_poses(moved(poses("needle"), 1e-3), lab / "needle.igs.mha")
    path = write(lab, SESSION)
    told = errors(run("validate", path))
    assert len(told) == 1
    assert told[0].startswith("tool.file: ")
    assert "needle.igs.mha: every position of tracker_from_needle lies within 0.1" in told[0]
    assert run("validate", path, "--for", "register").exit_code == 0


def test_what_is_doubtful_is_a_note_and_in_the_json(lab: Path) -> None:
    write_poses(moved(poses("needle"), by_mm=150.0), lab / "needle.igs.mha")
    done = run("validate", write(lab, SESSION), "--json")
    assert done.exit_code == 0
    assert done.stderr.startswith("note: tool: at this start the tool's tip comes no nearer to the heart")
    (warning,) = json.loads(done.stdout)["warnings"]
    assert (warning["key"], warning["cause"]) == ("tool", "TOOL_FAR_FROM_HEART")
