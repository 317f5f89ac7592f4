"""Uncertainty of an image calibration: a jackknife over blocks of time, and the refusal of too little motion.

Neither dots nor frames are independent samples: the dots of one frame share one pose error, and neighbouring
frames of a sweep share much of what no model holds (a bent wire, a beam's thickness, a wrong placement of the
phantom). On PLUS's N-wire recording, halves differ by up to 14 of the standard deviations that independent
frames would have. Leaving out one block of time at a time needs no model of it: the estimate's scatter
follows from the influence of each block.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student_t

from dvf_ig.calibration.refusal import Gate, Refusal
from dvf_ig.core import FloatArray, ImageMap, InvalidInputError, read_only_arrays

from .map_parameters import MapParameters
from .tracked_points import IndexArray

BLOCKS = 10
"""Blocks of time into which a recording is cut; each is left out once."""
DISPLAY_NAMES = {
    "about_lateral_rad": "rotation about the lateral axis",
    "about_axial_rad": "rotation about the axial direction",
    "about_elevation_rad": "rotation within the image plane",
    "lateral_mm": "lateral position",
    "axial_mm": "axial position",
    "elevation_mm": "elevation position",
    "log_column_size": "pixel width",
    "log_row_size": "pixel height",
    "log_pixel_size": "pixel size",
}


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class MapUncertainty:
    """Uncertainty of an image calibration.

    Attributes:
        parameters: the estimate, the pixel that its shifts are of, and what was free.
        covariance: (count, count) in the units of `parameters.names`.
        frames: frames behind it.
        held_out_mm: (frames,) RMS residual of each frame under the calibration made without it.
    """

    parameters: MapParameters
    covariance: FloatArray
    frames: int
    held_out_mm: FloatArray

    @property
    def coverage_factor(self) -> float:
        """Standard deviations to either side in a 95 % interval (Student's t over blocks; k of the GUM)."""
        return float(student_t.ppf(0.975, min(BLOCKS, self.frames) - 1))

    @property
    def half_width(self) -> FloatArray:
        """(count,) 95 % half-widths in the units of `parameters.names`."""
        return np.asarray(self.coverage_factor * np.sqrt(np.diag(self.covariance)))

    @property
    def all_half_widths(self) -> FloatArray:
        """(8,) `half_width`, the pixel's height as its width where pixels are square."""
        width = self.half_width
        return np.append(width, width[-1]) if self.parameters.isotropic else width

    @property
    def rotation_deg(self) -> FloatArray:
        """(3,) 95 % half-widths about the lateral, axial and elevation axes."""
        return np.degrees(self.half_width[:3])

    @property
    def center_mm(self) -> FloatArray:
        """(3,) 95 % half-widths of the centre pixel's position along the image's axes."""
        return self.half_width[3:6]

    @property
    def center_sd_mm(self) -> float:
        """Root of the summed variances of the centre pixel's position."""
        return float(np.sqrt(np.trace(self.covariance[3:6, 3:6])))

    @property
    def scale_mm_per_px(self) -> FloatArray:
        """(2, 2) 95 % interval of the pixel's width and height."""
        factor = self.all_half_widths[6:]
        return self.parameters.estimate.scale_mm_per_px[:, None] * np.exp(np.stack([-factor, factor], axis=1))

    def about(self, center_px: FloatArray) -> "MapUncertainty":
        """Express the uncertainty about another pixel instead of `parameters.center_px`."""
        old = self.parameters
        change = np.eye(old.count)
        change[3:6] = old.jacobian(np.asarray(center_px, dtype=np.float64))
        moved = MapParameters(old.estimate, np.asarray(center_px, dtype=np.float64), old.isotropic)
        covariance = change @ self.covariance @ change.T
        return MapUncertainty(moved, covariance, self.frames, self.held_out_mm)

    def point_mm(self, pixel: FloatArray) -> FloatArray:
        """Compute (3,) 95 % half-widths of the position of one pixel (2,), along the image's axes."""
        slope = self.parameters.jacobian(np.asarray(pixel, dtype=np.float64))
        spread = np.einsum("ij,jk,ik->i", slope, self.covariance, slope)
        return np.asarray(self.coverage_factor * np.sqrt(spread))

    def covers(self, truth: ImageMap) -> FloatArray:
        """Compute the (8,) deviation of `truth` over the 95 % half-width; within ±1 if covered."""
        return np.asarray(self.parameters.step_to(truth) / self.all_half_widths)


def time_blocks(frames: int) -> list[IndexArray]:
    """Split frames into blocks of time taken as independent samples; each block holds frame indices."""
    return np.array_split(np.arange(frames), min(BLOCKS, frames))


def block_jackknife(jacobian: FloatArray, residuals: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Estimate a least-squares fit's covariance by leaving out one block of time, to first order.

    Args:
        jacobian: (frames, k, p) of each frame's weighted residuals, in order of time.
        residuals: (frames, k).
    Returns:
        (p, p) covariance, and (frames, k) residuals that each frame has under the estimate without it.
    Raises:
        InvalidInputError: fewer frames than unknowns, or an unknown that one block alone determines.
    Source: Bell & McCaffrey 2002 ("CR3": the cluster jackknife), with H_ii = J_i (JᵀJ)⁻¹ J_iᵀ.
    """
    frames, _, unknowns = jacobian.shape
    if frames < max(3, unknowns):
        raise InvalidInputError(
            f"{frames} frames for {unknowns} unknowns; needed at least {max(3, unknowns)}"
        )
    inverse = np.linalg.pinv(np.einsum("fki,fkj->ij", jacobian, jacobian), hermitian=True)
    values, vectors = np.linalg.eigh(inverse)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    influence = []
    for block in time_blocks(frames):
        rows, own = jacobian[block].reshape(-1, unknowns), residuals[block].ravel()
        influence.append(inverse @ rows.T @ _held_out(root, rows, own))
    spread = np.stack(influence) - np.mean(influence, axis=0)
    held_out = [_held_out(root, rows, own) for rows, own in zip(jacobian, residuals, strict=True)]
    count = len(influence)
    return np.asarray((count - 1) / count * spread.T @ spread), np.stack(held_out)


def _held_out(root: FloatArray, rows: FloatArray, residuals: FloatArray) -> FloatArray:
    """(k,) residuals of some rows under the estimate without them: (I − H)⁻¹ r, H = J (JᵀJ)⁻¹ Jᵀ.

    In p unknowns instead of k rows: with `root` R, (JᵀJ)⁻¹ = R Rᵀ, and G = J R, it is
    r + G (I − GᵀG)⁻¹ Gᵀ r, and the least eigenvalue of I − GᵀG is that of I − H.
    """
    spread = rows @ root
    remainder = np.eye(spread.shape[1]) - spread.T @ spread
    if np.linalg.eigvalsh(remainder).min() < 1e-9:
        raise InvalidInputError(
            "one block of the recording alone determines an unknown; repeat each movement several times"
        )
    return np.asarray(residuals + spread @ np.linalg.solve(remainder, spread.T @ residuals))


def undetermined_refusals(
    parameters: MapParameters,
    jacobian: FloatArray,
    noise_mm: float,
    limits: tuple[float, float, float],
    advice: dict[str, str],
) -> tuple[Refusal, ...]:
    """Refuse data whose motion does not determine a part of the map, however small the residuals.

    Args:
        parameters: of the map; they come first among the unknowns.
        jacobian: (frames, k, p) of residuals in mm, p >= parameters.count.
        noise_mm: SD of one residual; the standard deviations follow from it.
        limits: largest SD of a rotation (rad), of a position (mm), of the log of a pixel size.
        advice: what to do, by parameter name.
    Returns:
        None, or one that names the undetermined parameters and the motion that would determine them.
    """
    flat = jacobian.reshape(-1, jacobian.shape[2])
    length = np.linalg.norm(flat, axis=0)
    _, values, rows = np.linalg.svd(flat / np.maximum(length, 1e-12), full_matrices=False)
    inverse = rows / np.maximum(values, 1e-9 * values[0])[:, None]
    sd = noise_mm * np.linalg.norm(inverse, axis=0) / np.maximum(length, 1e-12)
    limit = np.repeat(limits, 3)[: parameters.count]
    undetermined = [n for n, s, top in zip(parameters.names, sd, limit, strict=False) if s > top]
    if not undetermined:
        return ()
    worst = [f"{DISPLAY_NAMES[n]} (SD {_shown(n, sd[parameters.names.index(n)])})" for n in undetermined]
    actions = ", and ".join(dict.fromkeys(advice[n] for n in undetermined))
    needed = f"{np.degrees(limits[0]):.1f}°, {limits[1]:g} mm, {100 * limits[2]:g} %"
    detail = (
        f"the recorded motion does not determine the image calibration's {', '.join(worst)}; needed "
        f"SDs of at most {needed}: {actions}"
    )
    return (Refusal(Gate.UNCERTAIN, detail),)


def _shown(name: str, sd: float) -> str:
    if name.endswith("_rad"):
        return f"{min(np.degrees(sd), 180.0):.1f}°"
    return f"{min(sd, 999.0):.1f} mm" if name.endswith("_mm") else f"{min(100 * sd, 999.0):.1f} %"
