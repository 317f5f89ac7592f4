"""Build the part of a page that does not change with time: surfaces, distance, fixtures, state names."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

import dvf_ig
from dvf_ig.core import BoolArray, DvfModel, Fan, FloatArray, Landmarks, Mesh, Tissue, Warp
from dvf_ig.guidance import HAZARD_RULES, Evaluator, Gaussian, Hazard, Sigmoid, Status, SupervisorState, Tool
from dvf_ig.guidance.fixtures import FixtureOptions, FixtureSet
from dvf_ig.guidance.tissue import class_of
from dvf_ig.kernels.warp import LARGEST_SIGMA_MM
from dvf_ig.report.style import label_color

from .packing import packed, packed_exactly
from .surfaces import (
    SHARE_OF_CAP,
    CycleSurface,
    cycle_surface,
    fixture_surface,
    normal_shifts,
    shown_level_mm,
)

SCHEMA = "dvf_ig.view/1"
ORGAN_PITCH_MM, BLOOD_PITCH_MM, STRUCTURE_PITCH_MM = 4.0, 3.5, 3.0
VERTEX_STEP_MM, SHIFT_STEP_MM = 0.02, 0.01
DISTANCE_PITCH_MM, DISTANCE_STEP_MM, FARTHEST_MM = 3.0, 0.1, 12.6
PULL_BACK_STEP_MM = 0.1
FIELD_MARGIN_MM = 9.0
"""Margin around the organ in which the distance is included."""
FAN_POINTS = 24


@dataclass(frozen=True, slots=True, eq=False)
class SceneInput:
    """Content of a scene.

    Attributes:
        kind: "replay", "live", "registration" or "model".
        title: of the page.
        model: the patient's.
        fixtures: acting on the tool; None without a tool.
        image: shape of the sent ultrasound; None without ultrasound.
        ecg: label and unit of the ECG; None for a trigger.
        breathing: label and unit of a breathing signal; None without one.
        age_limit_s: age from which a pose is withheld.
        targets: named points in the model's frame.
        warp: change of the heart's shape since the MR; None if it has kept it.
    """

    kind: str
    title: str
    model: DvfModel
    fixtures: FixtureSet | None
    image: ImageShape | None
    ecg: tuple[str, str] | None
    breathing: tuple[str, str] | None = None
    age_limit_s: float | None = None
    targets: Landmarks | None = None
    warp: Warp | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ImageShape:
    """Size of a frame as sent.

    Attributes:
        columns, rows: in pixels.
        pixel_mm: width and height of one.
        step: (2,) recorded columns and rows per sent one.
        fan: insonified sector in recorded pixels; None if unknown.
    """

    columns: int
    rows: int
    pixel_mm: tuple[float, float]
    step: tuple[float, float]
    fan: Fan | None

    @property
    def recorded_from_sent(self) -> FloatArray:
        """Map (3, 3) from a sent pixel to a recorded one; both count centres."""
        (x, y) = self.step
        return np.array([[x, 0.0, (x - 1) / 2], [0.0, y, (y - 1) / 2], [0.0, 0.0, 1.0]])


def image_shape(
    rows: int, columns: int, pixel_mm: Sequence[float], fan: Fan | None, sent_columns: int
) -> ImageShape:
    """Compute the shape of recorded images when sent with at most `sent_columns` columns."""
    sent = min(columns, sent_columns)
    sent_rows = max(1, round(rows * sent / columns))
    step = (columns / sent, rows / sent_rows)
    return ImageShape(sent, sent_rows, (pixel_mm[0] * step[0], pixel_mm[1] * step[1]), step, fan)


def scene_payload(scene: SceneInput) -> dict[str, Any]:
    """Build the scene of a page (`dvf_ig/report/web/README.md`), without time series."""
    model = scene.model
    return {
        "schema": SCHEMA,
        "kind": scene.kind,
        "title": scene.title,
        "patient_id": model.patient_id,
        "version": dvf_ig.__version__,
        "heart": heart_payload(model, scene.fixtures, scene.warp),
        "distance": distance_payload(model),
        "labels": None if model.tissue is None else labels_payload(model.tissue, scene.warp),
        "fixtures": [] if scene.fixtures is None else [_fixture(one) for one in scene.fixtures.fixtures],
        "fixtures_cap_n": (scene.fixtures or FixtureSet()).joint_cap_n,
        "tool": None if scene.fixtures is None else tool_payload(scene.fixtures.tool),
        "image": None if scene.image is None else image_payload(scene.image),
        "signals": {"ecg": _signal(scene.ecg), "breathing": _signal(scene.breathing)},
        "words": words(),
        "age_limit_s": scene.age_limit_s,
        "targets": targets_payload(scene.targets),
    }


def heart_payload(model: DvfModel, fixtures: FixtureSet | None, warp: Warp | None = None) -> dict[str, Any]:
    """Encode surfaces of organ, blood and fixtures through the cycle.

    Args:
        warp: change of the heart's shape since the MR: organ and unseen are shown as in the MR, all other
            surfaces as the patient has them.
    """
    organ = cycle_surface(model.reference, ORGAN_PITCH_MM)
    surfaces = []
    unseen = _unseen(model, organ)
    for role, part in (("organ", ~unseen), ("unseen", unseen)):
        if part.any():
            shown = CycleSurface(organ.vertices_mm, organ.triangles[part])
            surfaces.append(_surface(model.surface_name, role, shown))
    surfaces += [
        _surface(chamber.name, "blood", _now(cycle_surface(chamber.surfaces, BLOOD_PITCH_MM), model, warp))
        for chamber in model.chambers
    ]
    surfaces += [] if warp is None else [_patient_surface(model, organ, warp)]
    surfaces += [] if fixtures is None else _fixture_surfaces(model, fixtures, organ, warp)
    low, high = organ.vertices_mm.min(axis=(0, 1)), organ.vertices_mm.max(axis=(0, 1))
    return {
        "surfaces": surfaces,
        "fractions": model.timing.fractions.tolist(),
        "center_mm": ((low + high) / 2).round(3).tolist(),
    }


def _now(surface: CycleSurface, model: DvfModel, warp: Warp | None) -> CycleSurface:
    """Move a surface of the MR to where the patient has it in each phase."""
    if warp is None:
        return surface
    at_rest = surface.vertices_mm[model.rest_phase]
    contracted = at_rest + warp.contraction * (surface.vertices_mm - at_rest)
    moved = np.stack([warp.patient_places(vertices) for vertices in contracted])
    return CycleSurface(moved, surface.triangles)


def _patient_surface(model: DvfModel, organ: CycleSurface, warp: Warp) -> dict[str, Any]:
    """Encode the organ's surface as the patient has it, with its certain shifts at end-diastole."""
    moved = _now(organ, model, warp)
    before = Mesh(model.frame, organ.vertices_mm[model.ed_phase], organ.triangles)
    outward, sigma_mm = normal_shifts(before, moved.vertices_mm[model.ed_phase], warp)
    too_uncertain = sigma_mm > LARGEST_SIGMA_MM
    outward[too_uncertain] = sigma_mm[too_uncertain] = np.nan
    return _surface(
        model.surface_name,
        "patient",
        moved,
        outward_mm=packed(outward, SHIFT_STEP_MM),
        sigma_mm=packed(sigma_mm, SHIFT_STEP_MM),
    )


def _unseen(model: DvfModel, organ: CycleSurface) -> BoolArray:
    """(t,) triangles that no slice shows at end-diastole; none of a model of the whole heart."""
    if model.seen is None:
        return np.zeros(len(organ.triangles), dtype=np.bool_)
    middles = organ.vertices_mm[model.ed_phase][organ.triangles].mean(axis=1)
    return ~model.seen.holds(middles, model.ed_phase)


def words() -> dict[str, Any]:
    """List names of states in the order of their codes, and hazards in the order of their bits."""
    return {
        "status": [status.name.lower() for status in sorted(Status)],
        "supervisor": [state.name.lower() for state in sorted(SupervisorState)],
        "hazards": [
            {"name": hazard.name.lower(), "sentence": HAZARD_RULES[hazard].sentence}
            for hazard in Hazard
            if hazard.name
        ],
    }


def _surface(name: str, role: str, surface: CycleSurface, **more: Any) -> dict[str, Any]:
    middle = float(np.round(surface.vertices_mm.mean()))
    return {
        "name": name,
        "role": role,
        "vertices": packed(surface.vertices_mm, VERTEX_STEP_MM, offset=middle, delta=True),
        "triangles": packed_exactly(surface.triangles),
        **more,
    }


def _fixture_surfaces(
    model: DvfModel, fixtures: FixtureSet, organ: CycleSurface, warp: Warp | None
) -> list[dict[str, Any]]:
    out = []
    surfaces: dict[DvfModel, CycleSurface] = {model: organ}
    for number, one in enumerate(fixtures.fixtures):
        of = one.structure or model
        if of not in surfaces:
            surfaces[of] = cycle_surface(of.reference, STRUCTURE_PITCH_MM)
            if of.surface_name != model.surface_name:
                out.append(_surface(of.surface_name, "structure", _through_cycle(surfaces[of], of, model)))
        if one.path is not None:
            continue
        level = shown_level_mm(one.law)
        aim = isinstance(one.law, Gaussian)
        label = "aim" if aim else f"from {SHARE_OF_CAP * one.law.cap_n:.2g} N"
        evaluator = Evaluator(of, one.law, withhold_unseen=False)
        surface = _through_cycle(fixture_surface(surfaces[of], evaluator, level), of, model)
        surface = _now(surface, model, warp)
        name = one.name or ("guidance" if aim else "forbidden region")
        out.append(_surface(name, "fixture", surface, level_mm=round(level, 3), label=label, fixture=number))
    return out


def _through_cycle(surface: CycleSurface, structure: DvfModel, model: DvfModel) -> CycleSurface:
    """Give the surface of a structure that does not beat as many phases as the model has."""
    if structure is model or not structure.still:
        return surface
    return CycleSurface(np.repeat(surface.vertices_mm[:1], model.phases, axis=0), surface.triangles)


def _fixture(one: FixtureOptions) -> dict[str, Any]:
    described: dict[str, Any] = dict(one.described())
    if one.path is not None:
        timing = one.path.timing
        described["path_mm"] = one.path.points_mm.round(3).tolist()
        described["path_fractions"] = [0.0] if timing is None else timing.fractions.tolist()
    return described


def tool_payload(tool: Tool) -> dict[str, float] | None:
    """Encode the thickness of a tool, and the length of its shaft that walls act on; None of a point."""
    if tool.diameter_mm == tool.shaft_mm == 0.0:
        return None
    return {"diameter_mm": tool.diameter_mm, "shaft_mm": tool.shaft_mm}


def distance_payload(model: DvfModel) -> dict[str, Any]:
    """Encode the signed distance on a grid around the organ, in every phase."""
    vertices = np.concatenate([mesh.vertices_mm for mesh in model.reference])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    shape = np.ceil((high - low + 2 * FIELD_MARGIN_MM) / DISTANCE_PITCH_MM).astype(int) + 1
    origin = low - FIELD_MARGIN_MM
    axes = [origin[a] + DISTANCE_PITCH_MM * np.arange(shape[a]) for a in range(3)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    evaluator = Evaluator(model, Sigmoid(), withhold_unseen=False)
    values = np.stack(
        [evaluator.force(points, phase).distance_mm for phase in model.timing.fractions.tolist()]
    )
    clipped = np.clip(values, -FARTHEST_MM, FARTHEST_MM).reshape(-1, *shape)
    return {
        "origin_mm": origin.round(6).tolist(),
        "spacing_mm": DISTANCE_PITCH_MM,
        "values": packed(clipped, DISTANCE_STEP_MM, delta=True),
    }


def labels_payload(tissue: Tissue, warp: Warp | None) -> dict[str, Any]:
    """Encode labels of end-diastole, the motion that leads there, and what is assumed of each tissue.

    Args:
        warp: change of the heart's shape since the MR, through which the labels are shown.
    """
    grid = tissue.labels.grid
    tissue = tissue if warp is None else tissue.contracting(warp.contraction)
    return {
        "kinds": [_label_kind(value, name) for value, name in tissue.names],
        "origin_mm": grid.origin_mm.tolist(),
        "spacing_mm": float(grid.spacing_mm[0]),
        "values": packed(tissue.labels.values, 1.0),
        "motion": _pull_backs(tissue.motion),
        "change": None if warp is None else _pull_backs((warp,)),
    }


def _label_kind(value: int, name: str) -> dict[str, Any]:
    """Encode a label with the properties of its tissue, each with its source; none of blood."""
    tissue = class_of(name)
    properties = [] if tissue is None else [list(one) for one in tissue.properties]
    kind = None if tissue is None else tissue.name
    return {
        "value": value,
        "name": name,
        "color": label_color(value),
        "tissue": kind,
        "properties": properties,
    }


def _pull_backs(warps: Sequence[Warp]) -> dict[str, Any]:
    """Encode splines on the same knots, one for each phase."""
    lanes = np.stack([warp.coefficients[..., :3] for warp in warps])
    return {
        "origin_mm": warps[0].origin_mm.tolist(),
        "knot_mm": warps[0].knot_mm,
        "coefficients_mm": packed(lanes, PULL_BACK_STEP_MM, delta=True),
    }


def image_payload(shape: ImageShape) -> dict[str, Any]:
    """Encode the frames' size and sector for `scene.json`."""
    return {
        "columns": shape.columns,
        "rows": shape.rows,
        "pixel_mm": [round(size, 6) for size in shape.pixel_mm],
        "fan_px": None if shape.fan is None else _fan_outline(shape.fan, shape.step),
    }


def _fan_outline(fan: Fan, step: tuple[float, float]) -> list[list[float]]:
    """Compute the corners of the sector in sent pixels."""
    angles = np.linspace(-fan.half_angle_rad, fan.half_angle_rad, FAN_POINTS)
    rays = np.column_stack([np.sin(angles), np.cos(angles)])
    near = [fan.apex_px] if fan.start_px == 0 else list((fan.apex_px + fan.start_px * rays)[::-1])
    outline = np.array([*(fan.apex_px + fan.stop_px * rays), *near])
    sent = (outline + 0.5) / np.array(step) - 0.5
    return [[round(float(v), 2) for v in row] for row in sent]


def _signal(named: tuple[str, str] | None) -> dict[str, str] | None:
    return None if named is None else {"label": named[0], "unit": named[1]}


def targets_payload(targets: Landmarks | None) -> list[dict[str, Any]]:
    """Encode named points."""
    if targets is None:
        return []
    places = targets.points.xyz_mm.round(3).tolist()
    return [{"name": name, "xyz_mm": place} for name, place in zip(targets.names, places, strict=True)]
