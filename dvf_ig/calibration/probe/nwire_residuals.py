"""Residuals of an N-wire phantom: the diagonals' dots in 3-D, or the dots of all wires in the image plane."""

from dataclasses import dataclass
from typing import Self

import numpy as np

from dvf_ig.core import (
    FloatArray,
    ImageMap,
    InvalidInputError,
    NWirePhantom,
    NWireRecording,
    Wire,
    read_only_arrays,
)

from .errors import CalibrationErrors, calibration_errors
from .map_parameters import MapParameters
from .tracked_points import TrackedPoints


def diagonal_crossings(pattern: tuple[Wire, Wire, Wire]) -> tuple[FloatArray, FloatArray]:
    """Intersect the extended diagonal of an N with its first and its last wire: (3,) mm each.

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


def wire_directions(phantom: NWirePhantom) -> FloatArray:
    """Compute (wires, 3) unit vectors from front to back."""
    return np.stack([_along(wire) for wire in phantom.wires])


def _meeting(diagonal: Wire, outer: Wire) -> FloatArray:
    """Point of the diagonal's line closest to the outer wire's line."""
    u, v = _along(diagonal), _along(outer)
    between = outer.front_mm - diagonal.front_mm
    b = float(u @ v)
    if 1.0 - b * b < 1e-4:
        raise InvalidInputError(
            f"wire {diagonal.name} runs parallel to {outer.name}; an N pattern needs a diagonal in the middle"
        )
    distance = (between @ u - b * (between @ v)) / (1.0 - b * b)
    point = diagonal.front_mm + distance * u
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


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class MiddleWires:
    """Diagonal wires: the image meets each at a point known in 3-D, by similar triangles in its N.

    Residuals are 3-D, mm, along the image's axes, (f, 3·patterns). A phantom without unknowns.

    Attributes:
        starts_mm, stops_mm: (patterns, 3) where each diagonal, extended, meets the first and the last wire of
            its N, frame "phantom".
    """

    starts_mm: FloatArray
    stops_mm: FloatArray

    @classmethod
    def of(cls, phantom: NWirePhantom) -> Self:
        """Build from a phantom; raises InvalidInputError if its wires do not form N patterns."""
        starts, stops = zip(*(diagonal_crossings(pattern) for pattern in phantom.patterns), strict=True)
        return cls(np.stack(starts), np.stack(stops))

    def met_mm(self, points: TrackedPoints) -> FloatArray:
        """Compute (f, patterns, 3) points at which the image meets each diagonal, at the probe.

        The diagonal's dot divides the chord between the outer dots as the imaged point divides the diagonal.

        Source: Comeau 1998.
        """
        first, middle, last = (points.pixels[:, k::3] for k in range(3))
        chord = last - first
        share = np.einsum("fpi,fpi->fp", middle - first, chord) / np.einsum("fpi,fpi->fp", chord, chord)
        in_phantom = self.starts_mm + share[..., None] * (self.stops_mm - self.starts_mm)
        offset = in_phantom - points.translations_mm[:, None]
        return np.asarray(np.einsum("fji,fpj->fpi", points.rotations, offset))

    def vectors_mm(self, columns: FloatArray, points: TrackedPoints) -> FloatArray:
        """Compute (f, patterns, 3) from each met point to where `columns` puts its dot, at the probe.

        Args:
            columns: (3, 3) any linear map [u, v, 1] -> mm; see `columns_of`.
        """
        dots = points.pixels[:, 1::3]
        return np.asarray(dots @ columns[:, :2].T + columns[:, 2] - self.met_mm(points))

    def errors_mm(self, columns: FloatArray, points: TrackedPoints) -> FloatArray:
        """Compute (f, patterns) lengths of `vectors_mm`."""
        return np.asarray(np.linalg.norm(self.vectors_mm(columns, points), axis=2))

    def residuals(self, image_map: ImageMap, points: TrackedPoints) -> FloatArray:
        vectors = self.vectors_mm(columns_of(image_map), points)
        return np.asarray((vectors @ image_map.rigid.rotation).reshape(len(points), -1))

    def jacobian(self, parameters: MapParameters, points: TrackedPoints) -> FloatArray:
        """(f, 3·patterns, count), the image's axes held fixed."""
        slope = parameters.jacobian(points.pixels[:, 1::3])
        return slope.reshape(len(slope), -1, parameters.count)

    def stepped(self, step: FloatArray) -> Self:
        return self


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class AllWires:
    """All wires: in-plane residuals over the noise along columns and rows, (f, 2·wires); no unknowns.

    Attributes:
        phantom: geometry.
        noise_mm: (2,) standard deviation of a dot along columns and rows.

    Source: Carbajal 2013.
    """

    phantom: NWirePhantom
    noise_mm: FloatArray

    def residuals(self, image_map: ImageMap, points: TrackedPoints) -> FloatArray:
        scaled = in_plane_residuals_mm(columns_of(image_map), points, self.phantom) / self.noise_mm
        return scaled.reshape(len(scaled), -1)

    def jacobian(self, parameters: MapParameters, points: TrackedPoints) -> FloatArray:
        """(f, 2·wires, count): a wire's crossing slides along the wire as the image plane moves."""
        image_map = parameters.estimate
        residuals = in_plane_residuals_mm(columns_of(image_map), points, self.phantom)
        slope = parameters.jacobian(points.pixels + residuals / image_map.scale_mm_per_px)
        along_probe = np.einsum("fji,wj->fwi", points.rotations, wire_directions(self.phantom))
        along = along_probe @ image_map.rigid.rotation
        slide = slope[:, :, 2:] / along[:, :, 2, None, None]
        crossing = along[:, :, :2, None] * slide - slope[:, :, :2]
        # residuals are lengths: they grow with the pixel
        sizes = np.zeros_like(crossing)
        sizes[..., [0, 1], [6, parameters.count - 1]] = residuals
        out = (crossing + sizes) / self.noise_mm[:, None]
        return np.asarray(out.reshape(len(out), -1, parameters.count))

    def stepped(self, step: FloatArray) -> Self:
        return self


def weighted_all_wires(image_map: ImageMap, points: TrackedPoints, phantom: NWirePhantom) -> AllWires:
    """Build all wires with each direction in units of its robust standard deviation under `image_map`."""
    residuals = in_plane_residuals_mm(columns_of(image_map), points, phantom)
    noise = np.maximum(1.4826 * np.median(np.abs(residuals), axis=(0, 1)), 1e-6)
    return AllWires(phantom, np.asarray(noise))


def in_plane_residuals_mm(columns: FloatArray, points: TrackedPoints, phantom: NWirePhantom) -> FloatArray:
    """Compute (f, wires, 2) mm along columns and rows, from each dot to its wire's crossing of the image."""
    across, down, origin = columns.T
    scale = np.array([np.linalg.norm(across), np.linalg.norm(down)])
    front = np.stack([w.front_mm for w in phantom.wires])
    along = wire_directions(phantom)
    front_probe = np.einsum("fji,fwj->fwi", points.rotations, front[None] - points.translations_mm[:, None])
    along_probe = np.einsum("fji,wj->fwi", points.rotations, along)
    normal = np.cross(across, down)
    depth = ((origin - front_probe) @ normal) / (along_probe @ normal)
    met = front_probe + depth[..., None] * along_probe - origin
    predicted = met @ np.linalg.pinv(np.column_stack([across, down])).T
    return np.asarray((predicted - points.pixels) * scale)


def wire_errors(columns: FloatArray, points: TrackedPoints, recording: NWireRecording) -> CalibrationErrors:
    """Measure 3-D errors of the diagonals and in-plane errors of every wire over the given frames."""
    in_plane = np.linalg.norm(in_plane_residuals_mm(columns, points, recording.phantom), axis=2).mean(axis=0)
    names = [wire.name for wire in recording.phantom.wires]
    return calibration_errors(
        MiddleWires.of(recording.phantom).errors_mm(columns, points),
        len(recording.phantom_from_probe),
        dict(zip(names, in_plane.tolist(), strict=True)),
    )


def columns_of(image_map: ImageMap) -> FloatArray:
    """Return (3, 3) columns u, v and origin of the map's matrix: [u, v, 1] -> mm."""
    return np.asarray(image_map.matrix[:3, [0, 1, 3]])
