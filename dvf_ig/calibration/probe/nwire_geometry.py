"""Geometry of N-wire images: which phantom point the diagonal's dot shows, and how far a map misses."""

from dataclasses import dataclass

import numpy as np

from dvf_ig.calibration.error_summary import summarise
from dvf_ig.core import FloatArray, InvalidInputError, NWirePhantom, NWireRecording, Wire, read_only_arrays

MEDIAN_NORM_PER_SIGMA = 1.5382
"""Median length of a 3-D Gaussian residual over its per-coordinate sigma (Maxwell distribution)."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class NWireFrames:
    """The usable frames of a recording as plain arrays.

    Attributes:
        frames: (f,) indices into the recording.
        pixels: (f, wires, 2) column, row of every wire.
        middle_probe_mm: (f, patterns, 3) where each diagonal was met, in frame "probe".
        rotations, translations_mm: (f, 3, 3), (f, 3) phantom_from_probe.
    """

    frames: np.ndarray[tuple[int], np.dtype[np.intp]]
    pixels: FloatArray
    middle_probe_mm: FloatArray
    rotations: FloatArray
    translations_mm: FloatArray

    @property
    def middle_pixels(self) -> FloatArray:
        """(f, patterns, 2) pixels of the diagonals."""
        return self.pixels[:, 1::3]

    def part(self, which: np.ndarray[tuple[int], np.dtype[np.bool_ | np.intp]]) -> "NWireFrames":
        """Some of the frames, by flags or by position."""
        return NWireFrames(
            self.frames[which],
            self.pixels[which],
            self.middle_probe_mm[which],
            self.rotations[which],
            self.translations_mm[which],
        )


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class WireErrors:
    """How well an image map puts the wires where the phantom has them.

    Attributes:
        mean_mm, sd_mm: 3-D error of the middle wires over all usable frames.
        mean95_mm, sd95_mm: the same over the lowest 95 % of the errors (PLUS's convention).
        frames_used: frames with every wire seen and a valid pose.
        frames: frames recorded.
        wire_names: (w,) names in the order of `in_plane_mm`.
        in_plane_mm: (w,) mean in-plane distance between each wire's dot and its predicted crossing.
        errors_mm: (frames_used, patterns) the 3-D errors themselves.
    """

    mean_mm: float
    sd_mm: float
    mean95_mm: float
    sd95_mm: float
    frames_used: int
    frames: int
    wire_names: tuple[str, ...]
    in_plane_mm: FloatArray
    errors_mm: FloatArray


def usable_frames(recording: NWireRecording) -> NWireFrames:
    """Frames whose pose is valid and whose wires were all segmented, with the diagonal's true position.

    Raises:
        InvalidInputError: no such frame, or a phantom whose wires do not form N patterns.
    """
    poses = recording.phantom_from_probe
    seen = np.isfinite(recording.points_px).all(axis=(1, 2))
    frames = np.flatnonzero(seen & poses.valid)
    if len(frames) == 0:
        raise InvalidInputError(
            f"none of {len(poses)} N-wire frames is usable: {int(seen.sum())} show all "
            f"{len(recording.phantom.wires)} wires and {int(poses.valid.sum())} have a valid "
            f"{poses.name}; record again with probe, reference and wires in view"
        )
    pixels = recording.points_px[frames]
    rotations, translations = poses.rotations[frames], poses.translations_mm[frames]
    middle_phantom = _middle_in_phantom(recording.phantom, pixels)
    offset = middle_phantom - translations[:, None]
    middle_probe = np.einsum("fji,fpj->fpi", rotations, offset)
    return NWireFrames(frames, pixels, middle_probe, rotations, translations)


def diagonal_crossings(pattern: tuple[Wire, Wire, Wire]) -> tuple[FloatArray, FloatArray]:
    """Where the diagonal, extended, meets the first and the last wire of an N: (3,) mm each.

    Raises:
        InvalidInputError: the outer wires are not parallel, or the diagonal does not cross them.
    """
    first, diagonal, last = pattern
    if np.degrees(_angle(_along(first), _along(last))) > 1.0:
        raise InvalidInputError(
            f"wires {first.name} and {last.name} are not parallel; an N pattern needs parallel outer wires, "
            "with the diagonal listed between them"
        )
    return _meeting(diagonal, first), _meeting(diagonal, last)


def measure_errors(probe_from_pixel: FloatArray, seen: NWireFrames, recording: NWireRecording) -> WireErrors:
    """Errors of a (3, 3) map [u, v, 1] -> probe mm over the given frames."""
    errors = middle_errors_mm(probe_from_pixel, seen)
    summary = summarise(errors.ravel())
    return WireErrors(
        mean_mm=summary.mean_mm,
        sd_mm=summary.sd_mm,
        mean95_mm=summary.mean95_mm,
        sd95_mm=summary.sd95_mm,
        frames_used=len(seen.frames),
        frames=len(recording.phantom_from_probe),
        wire_names=tuple(w.name for w in recording.phantom.wires),
        in_plane_mm=np.linalg.norm(
            in_plane_misses_mm(probe_from_pixel, seen, recording.phantom), axis=2
        ).mean(axis=0),
        errors_mm=errors,
    )


def middle_errors_mm(probe_from_pixel: FloatArray, seen: NWireFrames) -> FloatArray:
    """(f, patterns) 3-D distance between each diagonal's dot and where it must be."""
    return np.asarray(
        np.linalg.norm(_to_probe(probe_from_pixel, seen.middle_pixels) - seen.middle_probe_mm, axis=2)
    )


def in_plane_misses_mm(probe_from_pixel: FloatArray, seen: NWireFrames, phantom: NWirePhantom) -> FloatArray:
    """(f, wires, 2) mm along columns and rows, from each dot to where the image plane meets its wire."""
    across, down, origin = probe_from_pixel.T
    scale = np.array([np.linalg.norm(across), np.linalg.norm(down)])
    front = np.stack([w.front_mm for w in phantom.wires])
    along = wire_directions(phantom)
    front_probe = np.einsum("fji,fwj->fwi", seen.rotations, front[None] - seen.translations_mm[:, None])
    along_probe = np.einsum("fji,wj->fwi", seen.rotations, along)
    normal = np.cross(across, down)
    depth = ((origin - front_probe) @ normal) / (along_probe @ normal)
    met = front_probe + depth[..., None] * along_probe - origin
    plane = np.column_stack([across, down])
    predicted = met @ np.linalg.pinv(plane).T
    return np.asarray((predicted - seen.pixels) * scale)


def wire_directions(phantom: NWirePhantom) -> FloatArray:
    """(wires, 3) unit vectors from front to back."""
    return np.stack([_along(wire) for wire in phantom.wires])


def _middle_in_phantom(phantom: NWirePhantom, pixels: FloatArray) -> FloatArray:
    """(f, patterns, 3) by similar triangles: the dot divides the extended diagonal as it divides the dots."""
    middles = []
    for k, pattern in enumerate(phantom.patterns):
        start, stop = diagonal_crossings(pattern)
        first, middle, last = (pixels[:, 3 * k + j] for j in range(3))
        chord = last - first
        share = np.einsum("fi,fi->f", middle - first, chord) / np.einsum("fi,fi->f", chord, chord)
        middles.append(start + share[:, None] * (stop - start))
    return np.stack(middles, axis=1)


def _to_probe(probe_from_pixel: FloatArray, pixels: FloatArray) -> FloatArray:
    return np.asarray(pixels @ probe_from_pixel[:, :2].T + probe_from_pixel[:, 2])


def _meeting(diagonal: Wire, outer: Wire) -> FloatArray:
    """Point of the diagonal's line closest to the outer wire's line."""
    u, v = _along(diagonal), _along(outer)
    between = outer.front_mm - diagonal.front_mm
    b = float(u @ v)
    if 1.0 - b * b < 1e-4:
        raise InvalidInputError(
            f"wire {diagonal.name} runs parallel to {outer.name}; an N pattern needs a diagonal in the middle"
        )
    reach = (between @ u - b * (between @ v)) / (1.0 - b * b)
    point = diagonal.front_mm + reach * u
    gap = float(np.linalg.norm(np.cross(point - outer.front_mm, v)))
    if gap > 1.0:
        raise InvalidInputError(
            f"wire {diagonal.name} passes {gap:.2f} mm from {outer.name}, needed at most 1 mm: the three "
            "wires of an N lie in one plane"
        )
    return np.asarray(point)


def _along(wire: Wire) -> FloatArray:
    step = wire.back_mm - wire.front_mm
    length = float(np.linalg.norm(step))
    if length < 1e-6:
        raise InvalidInputError(f"wire {wire.name} has zero length; give two different end points")
    return np.asarray(step / length)


def _angle(u: FloatArray, v: FloatArray) -> float:
    return float(np.arcsin(min(1.0, float(np.linalg.norm(np.cross(u, v))))))
