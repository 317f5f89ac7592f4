"""Anatomy of one person at end-diastole: sizes, great vessels, and the warp of the standard heart."""

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from dvf_ig.core import FloatArray

from .heart_spec import HeartKind
from .mismatch import random_mismatch
from .population import KINDS, KindSpread, LeftVentricle, cavity_of, left_ventricle
from .shapes import HeartShape, heart_shape, with_vessels
from .warp import AnatomicalWarp

CENTER_MM = np.array([6.0, 2.0, 68.0])
"""Centre of the heart, heart frame; the warp's affine part leaves it in place."""
BOX_MM = np.array([[-52.0, -55.0, -4.0], [72.0, 58.0, 142.0]])
"""Box of the standard heart, heart frame."""
SHEAR_SD = 0.05
ELLIPTIC_SD = 0.04
INDIVIDUAL_MM = 1.3
CORRELATION_MM, WAVES = 32.0, 20
SEPTUM_MM, APEX_MM = 2.0, 2.5
"""SD of the bulge of the septum and of the shift of the apex."""
VESSEL_TURN_DEG = 8.0
VESSEL_SCALE = 0.08
ECCENTRIC_WIDTH_MM = np.array([16.0, 16.0, 30.0])
ECCENTRIC_CENTER_MM = np.array([0.0, 0.0, 48.0])
MIN_DETERMINANT = 0.25
ATTEMPTS = 50


@dataclass(frozen=True, slots=True, eq=False)
class VariedShape:
    """Standard heart's parts with a person's proportions, and the warp to this person."""

    kind: HeartKind
    heart: HeartShape
    warp: AnatomicalWarp


def varied_shape(kind: HeartKind, rng: np.random.Generator) -> VariedShape:
    """Draw until the warp is valid: det ∇W at least MIN_DETERMINANT all over the heart's neighbourhood."""
    spread = KINDS[kind]
    for _ in range(ATTEMPTS):
        ventricle = left_ventricle(
            spread.lv_edv_ml.draw(rng), spread.wall_mm.draw(rng), spread.elongation.draw(rng)
        )
        heart = _proportions(heart_shape(rng), ventricle, spread, rng)
        warp = _warp(ventricle, spread.septal_excess_mm.draw(rng), rng)
        if warp.determinant(_nodes(BOX_MM + np.array([[-30.0], [30.0]]))).min() > MIN_DETERMINANT:
            return VariedShape(kind, heart, warp)
    raise RuntimeError(f"no valid warp of a {kind} heart in {ATTEMPTS} draws")


def _proportions(
    heart: HeartShape, ventricle: LeftVentricle, spread: KindSpread, rng: np.random.Generator
) -> HeartShape:
    """Scale chambers and vessels relative to the left ventricle's epicardium."""
    rv, la, ra = spread.rv_scale.draw(rng), spread.la_scale.draw(rng), spread.ra_scale.draw(rng)
    lift = np.array([0.0, 0.0, 0.5])
    cavity = cavity_of(ventricle)
    narrow = np.array([cavity[0] / 25.0, cavity[0] / 25.0, 1.0])
    grown = replace(
        heart,
        rv_semi=rv * heart.rv_semi,
        la_semi=la * heart.la_semi,
        la_center=heart.la_center + lift * (la - 1.0) * heart.la_semi,
        ra_semi=ra * heart.ra_semi,
        ra_center=heart.ra_center + lift * (ra - 1.0) * heart.ra_semi,
        lv_cavity=cavity,
        papillary=heart.papillary * narrow,
        aorta_radius_mm=heart.aorta_radius_mm * float(np.exp(VESSEL_SCALE * rng.normal())),
        pulmonary_radius_mm=heart.pulmonary_radius_mm * float(np.exp(VESSEL_SCALE * rng.normal())),
        vein_radius_mm=heart.vein_radius_mm * float(np.exp(VESSEL_SCALE * rng.normal())),
        aorta_path=_turned(heart.aorta_path, rng),
        pulmonary_path=_turned(heart.pulmonary_path, rng),
        laa_path=_turned(heart.laa_path, rng),
    )
    return with_vessels(grown, Rotation.from_rotvec(_small_turn(rng)).as_matrix())


def _turned(path: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Turn a path about its first point."""
    turn = Rotation.from_rotvec(_small_turn(rng)).as_matrix()
    return np.asarray(path[0] + (path - path[0]) @ turn.T)


def _small_turn(rng: np.random.Generator) -> FloatArray:
    return np.deg2rad(np.clip(VESSEL_TURN_DEG * rng.normal(size=3), -15.0, 15.0))


def _warp(ventricle: LeftVentricle, septal_excess_mm: float, rng: np.random.Generator) -> AnatomicalWarp:
    elliptic = ELLIPTIC_SD * rng.normal()
    shear = np.clip(SHEAR_SD * rng.normal(size=(3, 3)), -0.12, 0.12) * (1 - np.eye(3))
    size = np.array(
        [ventricle.across * np.exp(elliptic), ventricle.across * np.exp(-elliptic), ventricle.along]
    )
    # the excess at the septum's two surfaces, of which the eccentric cavity moves one and not the other
    inner, outer = 0.85 * ventricle.inner_mm, 29.0
    width = ECCENTRIC_WIDTH_MM[0]
    share = np.exp(-0.5 * (inner / width) ** 2) - np.exp(-0.5 * (outer / width) ** 2)
    eccentric = np.clip(septal_excess_mm / ventricle.across / share, -16.0, 16.0)
    bumps = np.stack(
        [
            np.array([-eccentric, 0.0, 0.0]),
            np.array([np.clip(SEPTUM_MM * rng.normal(), -4.5, 4.5), 0.0, 0.0]),
            np.clip(APEX_MM * rng.normal(size=3), -5.0, 5.0),
        ]
    )
    field = random_mismatch(BOX_MM, INDIVIDUAL_MM, rng, CORRELATION_MM, WAVES)
    return AnatomicalWarp(
        affine=np.diag(size) @ (np.eye(3) + shear),
        center_mm=CENTER_MM,
        bump_center_mm=np.array([ECCENTRIC_CENTER_MM, [28.0, 0.0, 48.0], [0.0, 0.0, 2.0]]),
        bump_width_mm=np.array([ECCENTRIC_WIDTH_MM, [15.0, 20.0, 22.0], [20.0, 20.0, 18.0]]),
        bump_mm=bumps,
        field=field,
    )


def _nodes(box_mm: FloatArray, pitch_mm: float = 7.0) -> FloatArray:
    axes = [np.arange(low, high + pitch_mm, pitch_mm) for low, high in box_mm.T]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
