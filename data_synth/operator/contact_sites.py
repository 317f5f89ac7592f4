"""Sites on the beating heart that a tool can reach and touch."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.core import BoolArray, FloatArray, IntArray, InvalidInputError, read_only_arrays

from .contact import MovingSurface
from .hand import perpendicular


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Site:
    """Site on the heart: a point of the end-diastolic surface, its outward normal, a slide direction."""

    point_mm: FloatArray
    normal: FloatArray
    slide: FloatArray


def contact_sites(
    surface: MovingSurface, access: FloatArray, count: int, rng: np.random.Generator
) -> list[Site]:
    """Choose sites that a tool from direction `access` (3,) reaches, at the quieter parts of the surface.

    Raises:
        InvalidInputError: no part of the surface faces `access`.
    """
    resting = surface.vertices_mm[0]
    normals = _vertex_normals(resting, surface.triangles)
    outward = resting - resting.mean(axis=0)
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    motion = np.stack([surface.at(i / 32) for i in range(32)]) - resting
    travel = np.linalg.norm(motion, axis=2).max(axis=0)
    facing = (normals @ access > 0.6) & (outward @ access > 0.5) & _finely_meshed(resting, surface.triangles)
    candidates = np.flatnonzero(facing)
    if len(candidates) == 0:
        raise InvalidInputError("no part of the true surface faces the tool; check the anatomy's surface")
    quiet = candidates[travel[candidates] <= np.quantile(travel[candidates], 0.5)]
    chosen = [int(rng.choice(quiet))]
    while len(chosen) < count:
        apart = np.linalg.norm(resting[quiet, None] - resting[None, chosen], axis=2)
        near_last = apart[:, -1] < 40.0
        score = np.where(near_last, apart.min(axis=1), 0.0) * rng.uniform(0.5, 1.0, len(quiet))
        chosen.append(int(quiet[score.argmax()]))
    return [_site(resting, normals, index, rng) for index in chosen]


def _site(resting: FloatArray, normals: FloatArray, index: int, rng: np.random.Generator) -> Site:
    near = np.linalg.norm(resting - resting[index], axis=1) < 8.0
    normal = normals[near].mean(axis=0)
    normal /= np.linalg.norm(normal)
    return Site(resting[index].copy(), normal, perpendicular(normal, rng.standard_normal(3)))


def _vertex_normals(vertices: FloatArray, triangles: IntArray) -> FloatArray:
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    face = np.cross(b - a, c - a)
    out = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(out, triangles[:, k], face)
    return np.asarray(out / (np.linalg.norm(out, axis=1)[:, None] + 1e-300))


def _finely_meshed(vertices: FloatArray, triangles: IntArray) -> BoolArray:
    """Flag (v,) vertices without unusually large triangles, which are caps over openings."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    fine = np.ones(len(vertices), dtype=np.bool_)
    fine[triangles[area > 6.0 * np.median(area)]] = False
    return fine
