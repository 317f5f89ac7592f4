"""Data of the viewer's page from a replay's folder and its recording."""

from typing import Any

import numpy as np

from dvf_ig.cardiac.respiration import SurrogateScale, learn_scale
from dvf_ig.core import DvfModel, FloatArray, ImageMap, Respiration, Scenario, Signal
from dvf_ig.core.arrays import AnyArray
from dvf_ig.guidance import Confinement, FixtureOptions, FixtureSet, Gaussian, Law, PathTarget, Sigmoid, Tool
from dvf_ig.guidance.device import COMMON_DEVICE
from dvf_ig.intake.fixtures import DeviceConfig, ToolShapeConfig
from dvf_ig.report.viewer import (
    FrameSeries,
    ImageShape,
    Mark,
    SampledSignal,
    SceneInput,
    SeriesInput,
    image_shape,
    scene_payload,
    series_payload,
)
from dvf_ig.report.viewer.frames import SENT_COLUMNS
from dvf_ig.report.viewer.series import FORCE_MR, SHAFT
from dvf_ig.session.gated_frames import smoothed_poses
from dvf_ig.session.pose_states import MAX_AGE_S

from .outputs import read_shape
from .preconditions import tool_of
from .run_folder import RunFolder


def run_payload(run: RunFolder, scenario: Scenario, model: DvfModel) -> dict[str, Any]:
    """Build scene and series of a replay.

    Args:
        run: the replay's folder.
        scenario: the recording that was replayed.
        model: model of its patient.
    Raises:
        InvalidInputError: another patient's model.
    """
    model.require_patient(run.result["patient_id"])
    estimates, ultrasound = run.result["estimates"], scenario.ultrasound
    shape, frames, fixtures = None, None, _fixtures(run)
    if ultrasound.images is not None:
        probe_from_image = ImageMap.from_matrix(estimates["probe_from_image"], "probe")
        rows, columns = ultrasound.images.shape[1:]
        pixel_mm = probe_from_image.scale_mm_per_px.tolist()
        shape = image_shape(rows, columns, pixel_mm, scenario.fan, SENT_COLUMNS)
        frames = _frames(run, scenario, probe_from_image, shape)
    wave = scenario.ecg if isinstance(scenario.ecg, Signal) else None
    breath = scenario.respiration
    scale = None if breath is None else learn_scale(breath.values)
    scene = scene_payload(
        SceneInput(
            kind="replay",
            title=run.result["scenario"],
            model=model,
            fixtures=fixtures,
            image=shape,
            ecg=None if wave is None else (f"ECG {wave.leads[0]}", wave.unit),
            breathing=None if breath is None else ("breathing", "of a breath" if scale is not None else ""),
            age_limit_s=MAX_AGE_S,
            warp=read_shape(run.folder),
        )
    )
    series = SeriesInput(
        ticks=_ticks(run, scenario, fixtures.tool),
        ecg=None if wave is None else SampledSignal(wave.t_s, wave.samples[:, 0]),
        breathing=None if breath is None else _breath(breath, scale),
        r_peaks_s=run.view.r_peaks_s,
        frames=frames,
        marks=_marks(run.result),
    )
    return {**scene, "series": series_payload(series)}


def _breath(recorded: Respiration, scale: SurrogateScale | None) -> SampledSignal:
    """Scale what follows the breath: 0 at end-expiration, 1 at the usual top; unscaled if none is seen."""
    values = recorded.values[:, 0] if scale is None else scale.rho(recorded.values)
    return SampledSignal(recorded.t_s, values)


def _fixtures(run: RunFolder) -> FixtureSet:
    """Rebuild the fixtures that acted."""
    described = run.result["fixtures"]
    apart = zip(described, run.view.paths, run.view.structures, strict=True)
    parts = [_fixture(*one) for one in apart]
    stated = run.result.get("device")
    device = COMMON_DEVICE if stated is None else DeviceConfig.model_validate(stated).limits()
    tool = ToolShapeConfig.model_validate(run.result.get("tool") or {}).shape()
    return FixtureSet(tuple(parts), run.result["fixtures_cap_n"], device=device, tool=tool)


def _fixture(
    described: dict[str, Any], path: PathTarget | None, structure: DvfModel | None
) -> FixtureOptions:
    cap_n, depth_mm = described["cap_n"], described.get("depth_mm", 0.0)
    law: Law
    if "delta" in described:
        law = Gaussian(described["delta"], described["m"], cap_n, depth_mm)
    else:
        kind = Confinement if described["inside"] else Sigmoid
        law = kind(described["gamma"], cap_n, depth_mm)
    return FixtureOptions(law, described.get("blend", "force"), path, described["name"], structure)


def _ticks(run: RunFolder, scenario: Scenario, tool: Tool) -> dict[str, AnyArray]:
    """Return the table's columns, and force and direction of the shaft in the model's frame."""
    ticks = dict(run.ticks)
    rotation = run.view.pose_at(ticks["t_s"])[:, :, :3]
    force = np.column_stack([ticks[f"force_tracker_{axis}_n"] for axis in "xyz"])
    force_mr = np.einsum("nij,nj->ni", rotation, force)
    turns, places, tracked = tool_of(scenario).at_many(ticks["t_s"])
    tip_mm = np.array(run.result["estimates"]["tip_mm"])
    shaft = tool.handle_direction(tip_mm, turns @ tip_mm + places, turns)
    shaft_mr = np.einsum("nij,nj->ni", rotation, shaft)
    shaft_mr[~tracked] = np.nan
    for vector in (force_mr, shaft_mr):
        vector[np.isnan(ticks["tip_mr_x_mm"])] = np.nan
    columns = ((FORCE_MR, force_mr), (SHAFT, shaft_mr))
    return ticks | {name: vector[:, a] for names, vector in columns for a, name in enumerate(names)}


def _frames(
    run: RunFolder, scenario: Scenario, probe_from_image: ImageMap, shape: ImageShape
) -> FrameSeries | None:
    """Place frames with an image by the pose of their time."""
    ultrasound = scenario.ultrasound
    if ultrasound.images is None or not ultrasound.image_valid.any():
        return None
    shown = np.flatnonzero(ultrasound.image_valid)
    event_s = ultrasound.t_s[shown] + run.result["estimates"]["lag_s"]
    rotation, translation, tracked = smoothed_poses(ultrasound.stream("tracker", "probe"), event_s)
    probe_from_recorded = probe_from_image.matrix[:3, [0, 1, 3]]
    tracker_from_recorded = rotation @ probe_from_recorded
    tracker_from_recorded[:, :, 2] += translation
    pose = run.view.pose_at(event_s)
    mr_from_recorded = pose[:, :, :3] @ tracker_from_recorded
    mr_from_recorded[:, :, 2] += pose[:, :, 3]
    mr_from_recorded[~tracked] = np.nan
    nearest = np.clip(np.searchsorted(run.ticks["t_s"], event_s), 0, len(run.ticks["t_s"]) - 1)
    phase: FloatArray = run.ticks["model_phase"][nearest]
    return FrameSeries(event_s, phase, mr_from_recorded, ultrasound.images[shown], shape)


def _marks(result: dict[str, Any]) -> list[Mark]:
    """List registrations, and times without a pose, in order of time."""
    marks = [
        Mark(
            one["ready_s"],
            "registration" if one["usable"] else "refused",
            _registration(one),
            bound_mm=one.get("tre_bound_mm"),
        )
        for one in result["registrations"]
    ]
    marks += [
        Mark(span["begin_s"], "suspended", f"no pose: {span['why']}", span["end_s"])
        for span in result["withheld"]
    ]
    return sorted(marks, key=lambda mark: mark.t_s)


def _registration(one: dict[str, Any]) -> str:
    bound = one.get("tre_bound_mm")
    stated = "" if bound is None else f", largest error below {bound:.1f} mm"
    return f"registration {one['reason']}{stated}" if one["usable"] else f"registration: {one['reason']}"
