"""Largest plausible numbers of an operating room: beyond them a unit is wrong or data are damaged."""

from typing import Any

import numpy as np

from .arrays import BoolArray
from .errors import InvalidInputError

LENGTH_MM = 1e6
"""Largest coordinate: a kilometre, as trackers reach 5 m and scanners 2 m."""
TIME_S = 1e10
"""Largest time stamp: seconds since 1970 reach 1.8e9 (2026), milliseconds are beyond this limit."""
ECG_VALUE = 1e9
"""Largest ECG sample in any unit: converters of 24 bit count to 1.7e7, of 32 bit to 2.1e9 at most."""
MARKER_MM = (10.0, 1e4)
"""Farthest position of a marker from its tracker's origin or from another marker; trackers reach 5 m, so
poses in metres stay below 10."""
FEWEST_POSES = 10
"""Poses from which a recording's range is judged: fewer may be single measurements."""
PERIOD_S = (1e-4, 1.0)
"""Time between poses or images: 10 kHz to one a second. 50 images a second in ms have 20 "seconds"."""
SURFACE_MM = (10.0, 1e3)
"""Longest side of the box around a surface: a newborn's chamber has 15 mm; a heart in m 0.1, in inches 4."""
HEART_MM = (60.0, 200.0)
"""Usual longest side of the box around a heart: a small left ventricle; a dilated heart with its vessels."""
POSSIBLE_HEART_MM = (25.0, 500.0)
"""Possible ones: a newborn's heart has 40 mm; one in cm, inches or m has 20 at most."""
PIXEL_MM = (0.005, 2.0)
"""Smallest and largest side of an ultrasound pixel: probes of 50 MHz have 0.01 mm; an inverse map has 5."""
TIP_MM = (0.6, 1000.0)
"""Distance of a tool's tip from its marker, unless it is 0; a tip in m has 0.05 to 0.5."""
USUAL_TIP_MM = 2.0
"""Distance from the marker below which a tip is unusual."""
IMAGE_MM = 300.0
"""Farthest usual middle of an image from the marker of its probe: transthoracic probes have 50 to 150."""
LAG_S = 5.0
"""Largest latency of images: frame grabbers take 0.03 to 0.5 s; a latency in ms has 30 to 500."""
PHANTOM_MM = (5.0, 1000.0)
"""Longest side of the box around the wires or landmarks of a phantom."""
SPREAD_MM = (2.0, 1e4)
"""Largest distance between three or more landmarks; on a body in m it is below 2."""

ECG_RATE_HZ = (20.0, 50_000.0)
"""Slowest and fastest sampling of an ECG: long-term recorders keep 100 Hz, laboratories record 40 kHz."""
ECG_SWING_MV = (0.01, 100.0)
"""Smallest and largest swing of an ECG from beat to beat: a chest lead has 0.3 to 10 mV, one from inside the
heart 40 mV; a wrong unit is off by 1000."""
RR_S = (0.2, 3.0)
"""Shortest and longest RR interval: 300 and 20 beats/min."""
CYCLE_SHARE = 0.4
"""Least share of the RR interval that the phases of a cine span: prospective gating covers 80 % or more."""
VOLUME_STEP_S = (0.002, 3.0)
"""Shortest and longest time from one 3-D ultrasound volume to the next: probes take 1 to 100 volumes/s."""
LABELS_MM = (5.0, 1e3)
"""Longest side of the box around labels: a newborn's chamber has 15 mm, a heart in m 0.1, in inches 4."""
VOXEL_MM = (0.02, 100.0)
"""Smallest and largest voxel side of a scanner: CT has 0.2 mm, ultrasound 0.05, slices at most 20 apart."""
SCANNER_MM = 1e4
"""Farthest point of an image: tables travel 2 m, trackers reach 5 m."""


def require_plausible(values: Any, most: float, what: str) -> None:
    """Refuse finite numbers beyond `most`; numbers that are not finite are checked elsewhere.

    Raises:
        InvalidInputError: a number is larger; the message states it.
    """
    if isinstance(values, float) and abs(values) <= most:
        return
    array = np.abs(np.asarray(values, dtype=np.float64))
    if not (array > most).any():
        return
    if (beyond := array[np.isfinite(array) & (array > most)]).size:
        raise InvalidInputError(
            f"{what} reaches {float(beyond.max()):.3g}; needed at most {most:g}: check its unit and source"
        )


def identities(matrices: Any) -> BoolArray:
    """Return (n,) True for (n, 4, 4) poses that are exactly the identity.

    Drivers and recorders write it for a marker that they do not see, some with the status OK; no measured
    pose has sixteen such digits.
    """
    return np.asarray((np.asarray(matrices) == np.eye(4)).all(axis=(-2, -1)))


def marker_problem(name: str, positions_mm: Any) -> str | None:
    """Say why (n, 3) positions of a moving marker cannot be in mm; None if they can.

    Args:
        name: of the poses, for the sentence.
        positions_mm: of the valid poses of one recording.
    """
    positions = np.asarray(positions_mm, dtype=np.float64)
    if not len(positions):
        return None
    farthest = float(np.linalg.norm(positions, axis=1).max())
    if farthest > MARKER_MM[1]:
        return (
            f"{name} reaches {farthest:.3g} mm; no tracker measures beyond {MARKER_MM[1]:g} mm: the poses "
            "are in another unit (um?) or damaged; export them again in mm"
        )
    if farthest < MARKER_MM[0] and len(positions) >= FEWEST_POSES and np.ptp(positions, axis=0).any():
        return (
            f"every position of {name} lies within {farthest:.2g} mm of the origin, where no marker can be: "
            "the poses are in m, not mm; export them again in mm"
        )
    return None


def period_problem(t_s: Any) -> str | None:
    """Say why increasing stamps of poses or images cannot be in seconds; None if they can."""
    times = np.asarray(t_s, dtype=np.float64)
    if len(times) < 2:
        return None
    period_s = float(np.median(np.diff(times)))
    if PERIOD_S[0] <= period_s <= PERIOD_S[1]:
        return None
    unit = f"ms (then {1e3 / period_s:.3g} a second)" if period_s > PERIOD_S[1] else "another unit"
    return (
        f"one sample in {period_s:.3g} s, and {PERIOD_S[0]:g} to {PERIOD_S[1]:g} s are usual: the time "
        f"stamps are in {unit}, or the recording was made picture by picture; export them again in s"
    )


def surface_problem(vertices_mm: Any) -> str | None:
    """Say why (v, 3) vertices cannot be a surface of an organ in mm; None if they can."""
    return _side_problem(vertices_mm, SURFACE_MM, "an organ's surface")


def heart_problem(vertices_mm: Any) -> str | None:
    """Say why (v, 3) vertices of a heart's outer surface cannot be in mm; None if they can."""
    return _side_problem(vertices_mm, POSSIBLE_HEART_MM, "a heart's surface")


def spread_problem(points_mm: Any) -> str | None:
    """Say why (n, 3) landmarks cannot be in mm; None if they can, or are fewer than three."""
    return _side_problem(points_mm, SPREAD_MM, "a set of landmarks") if len(points_mm) >= 3 else None


def phantom_problem(points_mm: Any) -> str | None:
    """Say why (n, 3) end points of wires or landmarks cannot be a phantom in mm; None if they can."""
    return _side_problem(points_mm, PHANTOM_MM, "a phantom")


def pixel_problem(sides_mm: Any) -> str | None:
    """Say why an ultrasound pixel cannot have these sides, mm; None if it can."""
    least, most = float(np.min(sides_mm)), float(np.max(sides_mm))
    if least >= PIXEL_MM[0] and most <= PIXEL_MM[1]:
        return None
    return (
        f"its pixels have {least:.3g} to {most:.3g} mm; {PIXEL_MM[0]:g} to {PIXEL_MM[1]:g} mm are possible: "
        "it is not in mm per pixel, or the inverse (image_from_probe); calibrate the probe again"
    )


def tip_problem(tip_mm: Any) -> str | None:
    """Say why a tool's tip cannot have this position relative to its marker; None if it can."""
    length = float(np.linalg.norm(tip_mm))
    if length == 0.0 or TIP_MM[0] <= length <= TIP_MM[1]:
        return None
    unit = "in m, not mm" if length < TIP_MM[0] else "in another unit than mm"
    return f"the tip lies {length:.3g} mm from the tool's marker: it is {unit}; calibrate it again"


def lag_problem(lag_s: float) -> str | None:
    """Say why a latency cannot be in seconds; None if it can."""
    if abs(lag_s) <= LAG_S:
        return None
    return f"the latency is {lag_s:.3g} s, and at most {LAG_S:g} s are possible: it is in ms; give it in s"


def _side_problem(xyz_mm: Any, sides_mm: tuple[float, float], what: str) -> str | None:
    """Compare the longest side of the box around points with a range."""
    side = float(np.ptp(np.asarray(xyz_mm, dtype=np.float64), axis=0).max(initial=0.0))
    if side == 0.0 or sides_mm[0] <= side <= sides_mm[1]:
        return None
    units = (("m", 1e3), ("cm", 10.0)) if side < sides_mm[0] else (("um", 1e-3),)
    likely = next((u for u in units if sides_mm[0] <= side * u[1] <= sides_mm[1]), None)
    guess = "another unit" if likely is None else f"{likely[0]} (then {side * likely[1]:.3g} mm)"
    return (
        f"is {side:.3g} mm across, and {what} has {sides_mm[0]:g} to {sides_mm[1]:g} mm: it is in {guess}; "
        "export it again in mm"
    )
