"""Least-squares fits of an image map to the wires that an N-wire phantom shows, and how sure they are."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from dvf_ig.core import (
    FloatArray,
    ImageMap,
    InvalidInputError,
    NotConvergedError,
    NWirePhantom,
    QualityGateError,
    read_only_arrays,
)

from .covariance import MapUncertainty, piece_jackknife
from .map_parameters import MapParameters, with_square_pixels
from .nwire_geometry import NWireFrames, in_plane_misses_mm, wire_directions

ProbeMethod = Literal["linear", "orthogonal", "isotropic", "all-wires"]
PROBE_METHODS: tuple[ProbeMethod, ...] = ("linear", "orthogonal", "isotropic", "all-wires")

MAX_STEPS = 50


@dataclass(frozen=True, slots=True, eq=False)
class MiddleWires:
    """3-D misses of the diagonals' dots in mm, along the image's axes; (f, 3·patterns) a frame."""

    seen: NWireFrames

    def residuals(self, image_map: ImageMap) -> FloatArray:
        met = self.seen.middle_probe_mm
        misses = middle_design(self.seen) @ columns_of(image_map).T - met.reshape(-1, 3)
        return np.asarray(misses @ image_map.rigid.rotation).reshape(len(met), -1)

    def jacobian(self, parameters: MapParameters) -> FloatArray:
        """(f, 3·patterns, count), the image's axes held fixed."""
        slope = parameters.jacobian(self.seen.middle_pixels)
        return slope.reshape(len(slope), -1, parameters.count)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AllWires:
    """In-plane misses of every wire's dot over the noise along columns and rows; (f, 2·wires) a frame."""

    seen: NWireFrames
    phantom: NWirePhantom
    noise_mm: FloatArray

    def misses_mm(self, image_map: ImageMap) -> FloatArray:
        """(f, wires, 2)."""
        return in_plane_misses_mm(columns_of(image_map), self.seen, self.phantom)

    def residuals(self, image_map: ImageMap) -> FloatArray:
        misses = self.misses_mm(image_map) / self.noise_mm
        return misses.reshape(len(misses), -1)

    def jacobian(self, parameters: MapParameters) -> FloatArray:
        """(f, 2·wires, count): a wire's crossing slides along the wire as the image plane moves."""
        image_map = parameters.estimate
        misses = self.misses_mm(image_map)
        slope = parameters.jacobian(self.seen.pixels + misses / image_map.scale_mm_per_px)
        along_probe = np.einsum("fji,wj->fwi", self.seen.rotations, wire_directions(self.phantom))
        along = along_probe @ image_map.rigid.rotation
        slide = slope[:, :, 2:] / along[:, :, 2, None, None]
        crossing = along[:, :, :2, None] * slide - slope[:, :, :2]
        # misses are lengths: they grow with the pixel
        sizes = np.zeros_like(crossing)
        sizes[..., [0, 1], [6, parameters.count - 1]] = misses
        out = (crossing + sizes) / self.noise_mm[:, None]
        return np.asarray(out.reshape(len(out), -1, parameters.count))


def linear_map(seen: NWireFrames) -> FloatArray:
    """(3, 3) [u, v, 1] -> probe mm by least squares on the middle wires."""
    design = middle_design(seen)
    return np.asarray(np.linalg.lstsq(design, seen.middle_probe_mm.reshape(-1, 3), rcond=None)[0].T)


def linear_covariance(seen: NWireFrames, linear: FloatArray) -> tuple[FloatArray, float]:
    """Covariance of the linear map and its worst standard deviation at the corners of the dots' region."""
    design = middle_design(seen)
    residual = seen.middle_probe_mm.reshape(-1, 3) - design @ linear.T
    freedom = max(1, len(design) - 3)
    noise = residual.T @ residual / freedom
    inverse = np.linalg.pinv(design.T @ design)
    low, high = design[:, :2].min(axis=0), design[:, :2].max(axis=0)
    corners = np.array([[u, v, 1.0] for u in (low[0], high[0]) for v in (low[1], high[1])])
    leverage = np.einsum("ci,ij,cj->c", corners, inverse, corners)
    return np.kron(inverse, noise), float(np.sqrt(leverage.max() * np.trace(noise)))


def fit_map(
    seen: NWireFrames, linear: FloatArray, sensor: str, phantom: NWirePhantom, method: ProbeMethod
) -> ImageMap:
    """The map of the chosen method, started from the free linear one.

    Raises:
        QualityGateError: the linear map's axes are far from orthogonal.
        NotConvergedError: the refinement did not settle.
    """
    matrix = np.eye(4)
    matrix[:3, [0, 1, 3]] = linear
    try:
        start = ImageMap.from_matrix(matrix, sensor)
    except InvalidInputError as exc:
        raise QualityGateError(
            f"the wires give image axes {shear_deg(linear):.2f}° off orthogonal, needed at most 1°; "
            "check wire order, phantom geometry and image spacing"
        ) from exc
    start = ImageMap(start.rigid, start.scale_mm_per_px)
    if method == "linear":
        return start
    if method != "all-wires":
        return _refined(start, MiddleWires(seen), isotropic=method == "isotropic")
    # axial and lateral dots differ in noise: fit, weigh each direction by its scatter, fit again
    found = _refined(start, AllWires(seen, phantom, np.ones(2)), isotropic=False)
    return _refined(found, _weighed(found, seen, phantom), isotropic=False)


def map_uncertainty(
    image_map: ImageMap, seen: NWireFrames, phantom: NWirePhantom, method: ProbeMethod
) -> MapUncertainty:
    """Spread of the fitted map over frames; for "linear" that of the same fit with orthogonal axes.

    Raises:
        InvalidInputError: one frame alone determines an unknown.
    """
    wires = _weighed(image_map, seen, phantom) if method == "all-wires" else MiddleWires(seen)
    unit = wires.noise_mm if isinstance(wires, AllWires) else np.ones(3)
    parameters = MapParameters(image_map, _center_px(seen), method == "isotropic")
    covariance, held_out = piece_jackknife(wires.jacobian(parameters), wires.residuals(image_map))
    misses = held_out.reshape(len(held_out), -1, len(unit)) * unit
    rms = np.sqrt((misses**2).sum(axis=2).mean(axis=1))
    return MapUncertainty(parameters, covariance, len(seen.frames), rms)


def columns_of(image_map: ImageMap) -> FloatArray:
    """(3, 3) columns u, v and origin of the map's matrix."""
    return np.asarray(image_map.matrix[:3, [0, 1, 3]])


def middle_design(seen: NWireFrames) -> FloatArray:
    """(f·patterns, 3) rows [u, v, 1] of the middle wires."""
    flat = seen.middle_pixels.reshape(-1, 2)
    return np.column_stack([flat, np.ones(len(flat))])


def shear_deg(linear: FloatArray) -> float:
    """How far the two axes of a linear map are from orthogonal."""
    u, v = linear[:, 0], linear[:, 1]
    cosine = float(u @ v / max(1e-30, float(np.linalg.norm(u) * np.linalg.norm(v))))
    return abs(90.0 - float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def _refined(start: ImageMap, wires: MiddleWires | AllWires, *, isotropic: bool) -> ImageMap:
    """Gauss-Newton with halved steps, linearised anew about every map."""
    center = _center_px(wires.seen)
    current = MapParameters(with_square_pixels(start, center) if isotropic else start, center, isotropic)
    misses = wires.residuals(current.estimate).ravel()
    for _ in range(MAX_STEPS):
        jacobian = wires.jacobian(current).reshape(-1, current.count)
        step = np.asarray(np.linalg.lstsq(jacobian, -misses, rcond=None)[0], dtype=np.float64)
        for _ in range(20):
            trial = MapParameters(current.stepped(step), center, isotropic)
            moved = wires.residuals(trial.estimate).ravel()
            if moved @ moved <= misses @ misses * (1 + 1e-12):
                break
            step = step / 2
        current, misses = trial, moved
        if np.linalg.norm(step) < 1e-9:
            return current.estimate
    raise NotConvergedError(f"the probe calibration did not settle in {MAX_STEPS} steps; record more frames")


def _weighed(image_map: ImageMap, seen: NWireFrames, phantom: NWirePhantom) -> AllWires:
    """All wires, each direction over its robust SD under `image_map`."""
    misses = in_plane_misses_mm(columns_of(image_map), seen, phantom)
    noise = np.maximum(1.4826 * np.median(np.abs(misses), axis=(0, 1)), 1e-6)
    return AllWires(seen, phantom, np.asarray(noise))


def _center_px(seen: NWireFrames) -> FloatArray:
    """(2,) middle of the region that the wires covered."""
    flat = seen.pixels.reshape(-1, 2)
    return np.asarray(0.5 * (flat.min(axis=0) + flat.max(axis=0)))
