"""The N-wire solve: least-squares fits of probe_from_image to the wires seen, and their uncertainty."""

from typing import Literal

import numpy as np

from dvf_ig.core import (
    FloatArray,
    ImageMap,
    InvalidInputError,
    NotConvergedError,
    NWirePhantom,
    QualityGateError,
)

from .covariance import MapUncertainty, block_jackknife
from .map_fit import P, levenberg_marquardt, start_fit
from .map_parameters import MapParameters
from .nwire_residuals import AllWires, MiddleWires, weighted_all_wires
from .tracked_points import TrackedPoints

NWireMethod = Literal["linear", "orthogonal", "isotropic", "all-wires"]
NWIRE_METHODS: tuple[NWireMethod, ...] = ("linear", "orthogonal", "isotropic", "all-wires")


def linear_map(points: TrackedPoints, wires: MiddleWires) -> FloatArray:
    """Fit (3, 3) [u, v, 1] -> mm at the probe by linear least squares on the middle wires.

    Source: Comeau 1998, Chen 2009.
    """
    design = _design(points)
    return np.asarray(np.linalg.lstsq(design, wires.met_mm(points).reshape(-1, 3), rcond=None)[0].T)


def linear_covariance(
    points: TrackedPoints, wires: MiddleWires, linear: FloatArray
) -> tuple[FloatArray, float]:
    """Compute the linear map's covariance and its worst standard deviation at the dots' corners."""
    design = _design(points)
    residual = wires.met_mm(points).reshape(-1, 3) - design @ linear.T
    freedom = max(1, len(design) - 3)
    noise = residual.T @ residual / freedom
    inverse = np.linalg.pinv(design.T @ design)
    low, high = design[:, :2].min(axis=0), design[:, :2].max(axis=0)
    corners = np.array([[u, v, 1.0] for u in (low[0], high[0]) for v in (low[1], high[1])])
    leverage = np.einsum("ci,ij,cj->c", corners, inverse, corners)
    return np.kron(inverse, noise), float(np.sqrt(leverage.max() * np.trace(noise)))


def fit_map(
    points: TrackedPoints, phantom: NWirePhantom, linear: FloatArray, method: NWireMethod
) -> ImageMap:
    """Fit the map of the chosen method, starting from the free linear one.

    Raises:
        QualityGateError: the linear map's axes are far from orthogonal.
        NotConvergedError: the fit did not converge.
    """
    matrix = np.eye(4)
    matrix[:3, [0, 1, 3]] = linear
    try:
        start = ImageMap.from_matrix(matrix, points.source)
    except InvalidInputError as exc:
        raise QualityGateError(
            f"the wires give image axes {shear_deg(linear):.2f}° off orthogonal, needed at most 1°; "
            "check wire order, phantom geometry and image spacing"
        ) from exc
    start = ImageMap(start.rigid, start.scale_mm_per_px)
    if method == "linear":
        return start
    if method != "all-wires":
        return _fitted(start, MiddleWires.of(phantom), points, isotropic=method == "isotropic")
    # axial and lateral dots differ in noise: fit, weigh each direction by its scatter, fit again
    first = _fitted(start, AllWires(phantom, np.ones(2)), points, isotropic=False)
    return _fitted(first, weighted_all_wires(first, points, phantom), points, isotropic=False)


def map_uncertainty(
    image_map: ImageMap, points: TrackedPoints, phantom: NWirePhantom, method: NWireMethod
) -> MapUncertainty:
    """Estimate the fitted map's uncertainty from blocks of frames; "linear" gets that of orthogonal axes.

    Raises:
        InvalidInputError: one block of frames alone determines an unknown.
    """
    parameters = MapParameters(image_map, points.center_px, method == "isotropic")
    wires: MiddleWires | AllWires = MiddleWires.of(phantom)
    unit = np.ones(3)
    if method == "all-wires":
        wires = weighted_all_wires(image_map, points, phantom)
        unit = wires.noise_mm
    covariance, held_out = block_jackknife(
        wires.jacobian(parameters, points), wires.residuals(image_map, points)
    )
    residuals = held_out.reshape(len(held_out), -1, len(unit)) * unit
    rms = np.sqrt((residuals**2).sum(axis=2).mean(axis=1))
    return MapUncertainty(parameters, covariance, len(points), rms)


def shear_deg(linear: FloatArray) -> float:
    """Compute how far the two axes of a linear map are from orthogonal, degrees."""
    u, v = linear[:, 0], linear[:, 1]
    cosine = float(u @ v / max(1e-30, float(np.linalg.norm(u) * np.linalg.norm(v))))
    return abs(90.0 - float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))))


def _fitted(start: ImageMap, wires: P, points: TrackedPoints, *, isotropic: bool) -> ImageMap:
    first = start_fit(start, wires, points, isotropic=isotropic)
    fit = levenberg_marquardt(first, points, damping=0.0)
    if not fit.converged:
        raise NotConvergedError("the probe calibration did not converge; record more frames")
    return fit.parameters.estimate


def _design(points: TrackedPoints) -> FloatArray:
    """(f·patterns, 3) rows [u, v, 1] of the middle wires."""
    flat = points.pixels[:, 1::3].reshape(-1, 2)
    return np.column_stack([flat, np.ones(len(flat))])
