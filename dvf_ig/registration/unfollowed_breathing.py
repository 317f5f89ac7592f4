"""Evidence that a heart moves with the breath, from the poses of single beats alone.

The poses of the last beats are fitted by a constant (another one after each shift), a linear drift, an error
that depends on the view v of the probe, and one oscillation of all six coordinates, each beat with its own
information,

    ξ = a + b t + e(v) + c cos 2πft + d sin 2πft,

for the frequencies of breathing. How much the oscillation lowers χ² is the evidence. A hand that sweeps the
probe to and fro makes an oscillation too, of e: what the view explains at its usual size is no evidence. e is
a Gaussian process: views that differ little share their error.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import solve_triangular

from dvf_ig.core import FloatArray, read_only_arrays

from .breathing import CONSTANT_MM, normal_matrix
from .pose_chart import PoseChart
from .tracking.pose_estimate import BeatMeasurement

LEAST_BEATS, MOST_BEATS = 12, 32
"""Beats that are evidence of an oscillation, and that are remembered."""
FREQUENCIES_HZ = np.arange(0.1, 0.56, 0.02)
"""Six to 33 breaths a minute, at the resolution of MOST_BEATS."""
BEATS_A_BREATH = 2.2
"""Fewest beats a breath in which it is still seen."""
OSCILLATION_MM = 5.0
"""Prior SD of drift and oscillation."""
VIEW_MM, VIEW_REACH_MM = 0.5, 30.0
"""SD of each coordinate's error by the view, and how far points of its plane move until it is another one: by
the likelihood of beats of still hearts (docs/theory/respiration.md)."""
VIEW_SHARE = 0.01
"""Least variance, relative to the largest, of a component of the errors of all views that is fitted."""
FOUND, GONE = 55.0, 28.0
"""Fall of χ² from which an oscillation is breathing, and below which it no longer is."""
LEAST_MM, GONE_MM = 1.0, 0.7
"""The same limits of the amplitude of the translation."""
SUSPECT = 20.0
"""Fall of χ² from which the first beats do not exclude breathing."""
SUSPECT_CYCLES = 1.8
"""Fewest breaths in these beats: a slower oscillation is not told from the drift of views."""


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class BeatPose:
    """Pose of one beat.

    Attributes:
        t_s: half-way through it.
        information: (6, 6) J, 1/mm²; offset_information: (6,) J ξ, in one `PoseChart` for all beats.
        square: ξᵀ J ξ.
        view_mm: (9,) three points of the plane that it shows, frame "tracker".
        place: number of the place where the heart lay, which a shift counts up.
    """

    t_s: float
    information: FloatArray
    offset_information: FloatArray
    square: float
    view_mm: FloatArray
    place: int


@dataclass(frozen=True, slots=True)
class Oscillation:
    """Strongest oscillation of the poses of beats.

    Attributes:
        per_minute: its frequency; amplitude_mm: of the translation.
        fall: of χ², over that of what is left if the beats scatter more than they state.
    """

    per_minute: float
    fall: float
    amplitude_mm: float

    @property
    def is_suspect(self) -> bool:
        """Whether the first beats do not exclude breathing."""
        return self.fall >= SUSPECT and self.amplitude_mm >= GONE_MM

    def is_breathing(self, *, before: bool) -> bool:
        """Whether it is taken for breathing, `before`: also by the beats until the last."""
        least, least_mm = (GONE, GONE_MM) if before else (FOUND, LEAST_MM)
        return self.fall >= least and self.amplitude_mm >= least_mm


class OscillationWatch:
    """Watch over the poses of successive beats.

    Args:
        center_mm: (3,) centre of the heart, model frame.
    """

    def __init__(self, center_mm: FloatArray) -> None:
        self.found: Oscillation | None = None
        """Breathing that the last beats show; None if they show none."""
        self.excluded = False
        """Whether LEAST_BEATS beats or more exclude breathing; after MOST_BEATS, whether they show none."""
        self.compared = 0
        """Beats that were compared with a pose."""
        self._center_mm = center_mm
        self._chart: PoseChart | None = None
        self._place = 0
        self._beats: deque[BeatPose] = deque(maxlen=MOST_BEATS)

    def add(self, middle_s: float, measurement: BeatMeasurement, view_mm: FloatArray) -> None:
        """Add a beat that was compared with a pose.

        Args:
            middle_s: half-way through it.
            view_mm: (3, 3) three points of the plane that it shows, frame "tracker".
        """
        self.compared += 1
        self._add(middle_s, measurement, view_mm)
        before, oscillation = self.found is not None, strongest_oscillation(tuple(self._beats))
        breathes = oscillation is not None and oscillation.is_breathing(before=before)
        self.found = oscillation if breathes else None
        if before or breathes:
            self.excluded = not breathes
        elif self.compared >= LEAST_BEATS and not self.excluded:
            first = strongest_oscillation(tuple(self._beats), SUSPECT_CYCLES)
            suspect = first is not None and first.is_suspect
            self.excluded = not suspect or self.compared >= MOST_BEATS

    def _add(self, middle_s: float, measurement: BeatMeasurement, view_mm: FloatArray) -> None:
        """Remember a beat that tells where the heart is."""
        if not measurement.informative or (self._beats and middle_s <= self._beats[-1].t_s):
            return
        if self._chart is None:
            self._chart = PoseChart(measurement.pose, self._center_mm)
        information = 0.5 * (measurement.information + measurement.information.T)
        from_base_mm = self._chart.coordinates(measurement.pose)
        offset = measurement.offset_information_mm + information @ from_base_mm
        square = float(offset @ np.linalg.pinv(information, rcond=1e-9, hermitian=True) @ offset)
        self._beats.append(BeatPose(middle_s, information, offset, square, view_mm.ravel(), self._place))

    def shifted(self, from_s: float) -> None:
        """Count beats from then on as those of another place: the heart has moved in another way."""
        self._place += 1
        moved = [replace(beat, place=self._place) if beat.t_s >= from_s else beat for beat in self._beats]
        self._beats = deque(moved, maxlen=MOST_BEATS)


def strongest_oscillation(beats: tuple[BeatPose, ...], cycles: float = 0.0) -> Oscillation | None:
    """Fit the oscillation of the lowest χ² of which beats show `cycles`; None from fewer than LEAST_BEATS."""
    if len(beats) < LEAST_BEATS:
        return None
    t_s = np.array([beat.t_s for beat in beats])
    t_s = t_s - t_s.mean()
    slowest_hz = cycles / float(np.ptp(t_s))
    fastest_hz = 1.0 / (BEATS_A_BREATH * float(np.median(np.diff(t_s))))
    hz = FREQUENCIES_HZ[(slowest_hz <= FREQUENCIES_HZ) & (fastest_hz >= FREQUENCIES_HZ)]
    if not len(hz):
        return Oscillation(0.0, 0.0, 0.0)
    angles = 2.0 * np.pi * np.outer(t_s, hz)
    waves = np.stack([np.cos(angles), np.sin(angles)], axis=2)
    lowered, left, waves_mm = _fits(beats, *_steady(beats, t_s), waves)
    places = len({beat.place for beat in beats})
    falls = lowered / np.maximum(1.0, left / (6 * (len(beats) - places - 3)))
    best = int(falls.argmax())
    amplitude_mm = float(np.linalg.norm(waves_mm[best, :, 3:]))
    return Oscillation(60.0 * float(hz[best]), float(falls[best]), amplitude_mm)


def _steady(beats: tuple[BeatPose, ...], t_s: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return (n, p) features of all that is no oscillation, and the (p,) prior SD of their coefficients."""
    places = np.array([beat.place for beat in beats])
    constants = places[:, None] == np.unique(places)
    views_mm = np.array([beat.view_mm for beat in beats])
    apart_mm2 = np.square(views_mm[:, None] - views_mm).sum(axis=2) / 3.0
    variances, components = np.linalg.eigh(np.exp(-0.5 * apart_mm2 / VIEW_REACH_MM**2))
    chosen = variances > VIEW_SHARE * variances[-1]
    views = components[:, chosen] * np.sqrt(variances[chosen])
    sizes = (constants.shape[1], 1, views.shape[1])
    return np.column_stack([constants, t_s / t_s.std(), views]), np.repeat(
        [CONSTANT_MM, OSCILLATION_MM, VIEW_MM], sizes
    )


def _fits(
    beats: tuple[BeatPose, ...], steady: FloatArray, steady_mm: FloatArray, waves: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Fit (n, p) steady features with each of (n, f, 2) waves by ridge.

    Returns:
        (f,) by how much the waves lower χ²; (f,) what is left of it; (f, 2, 6) their coefficients, mm.
    """
    information = np.array([beat.information for beat in beats])
    offsets = np.array([beat.offset_information for beat in beats])
    features = np.hstack([steady, waves.reshape(len(beats), -1)])
    count, alternatives = 6 * steady.shape[1], waves.shape[1]
    prior_mm = np.append(steady_mm, np.full(2 * alternatives, OSCILLATION_MM))
    matrix = normal_matrix(features, information) + np.diag(np.repeat(prior_mm**-2.0, 6))
    right = (features.T @ offsets).ravel()
    root = np.linalg.cholesky(matrix[:count, :count])
    shared = solve_triangular(root, matrix[:count, count:], lower=True).reshape(count, alternatives, 12)
    explained = solve_triangular(root, right[:count], lower=True)
    each = np.arange(alternatives)
    own = matrix[count:, count:].reshape(alternatives, 12, alternatives, 12)[each, :, each]
    own -= np.einsum("cfi,cfj->fij", shared, shared, optimize=True)
    pull = right[count:].reshape(alternatives, 12) - np.einsum("cfi,c->fi", shared, explained)
    waves_mm = np.linalg.solve(own, pull[:, :, None])[:, :, 0]
    lowered = np.einsum("fi,fi->f", waves_mm, pull)
    total = float(np.sum([beat.square for beat in beats]))
    return lowered, total - float(explained @ explained) - lowered, waves_mm.reshape(-1, 2, 6)
