"""Evidence that a heart moves with the breath, from the poses of single beats alone.

The poses of the last beats are fitted by a constant (another one after each shift), a linear drift and one
oscillation of all six coordinates, each beat with its own information,

    ξ(t) = a + b t + c cos 2πft + d sin 2πft,

for the frequencies of breathing. How much the oscillation lowers χ² is the evidence.
"""

from collections import deque
from dataclasses import dataclass, replace

import numpy as np

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
FOUND, GONE = 90.0, 45.0
"""Fall of χ² from which an oscillation is breathing, and below which it no longer is: between the 65 at most
that biases make which change with a sweeping view, and the 131 at least of 4 mm of breathing
(docs/theory/respiration.md)."""
LEAST_MM, GONE_MM = 1.0, 0.7
"""The same limits of the amplitude of the translation."""
SUSPECT, SUSPECT_A_BEAT = 32.0, 1.65
"""Fall of χ² from which LEAST_BEATS do not exclude breathing, and its growth with each further beat: between
the 28 at most (65 of all beats) that views make, and the 38 at least of 4 mm."""
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
        place: number of the place where the heart lay, which a shift counts up.
    """

    t_s: float
    information: FloatArray
    offset_information: FloatArray
    square: float
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

    def is_suspect(self, beats: int) -> bool:
        """Whether the first `beats` do not exclude breathing."""
        least = SUSPECT + SUSPECT_A_BEAT * (beats - LEAST_BEATS)
        return self.fall >= least and self.amplitude_mm >= GONE_MM

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

    def add(self, middle_s: float, measurement: BeatMeasurement) -> None:
        """Add a beat that was compared with a pose, with the time half-way through it."""
        self.compared += 1
        self._add(middle_s, measurement)
        before, oscillation = self.found is not None, strongest_oscillation(tuple(self._beats))
        breathes = oscillation is not None and oscillation.is_breathing(before=before)
        self.found = oscillation if breathes else None
        if before or breathes:
            self.excluded = not breathes
        elif self.compared >= LEAST_BEATS and not self.excluded:
            first = strongest_oscillation(tuple(self._beats), SUSPECT_CYCLES)
            suspect = first is not None and first.is_suspect(len(self._beats))
            self.excluded = not suspect or self.compared >= MOST_BEATS

    def _add(self, middle_s: float, measurement: BeatMeasurement) -> None:
        """Remember a beat that tells where the heart is."""
        if not measurement.informative or (self._beats and middle_s <= self._beats[-1].t_s):
            return
        if self._chart is None:
            self._chart = PoseChart(measurement.pose, self._center_mm)
        information = 0.5 * (measurement.information + measurement.information.T)
        from_base_mm = self._chart.coordinates(measurement.pose)
        offset = measurement.offset_information_mm + information @ from_base_mm
        square = float(offset @ np.linalg.pinv(information, rcond=1e-9, hermitian=True) @ offset)
        self._beats.append(BeatPose(middle_s, information, offset, square, self._place))

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
    information = np.array([beat.information for beat in beats])
    offsets = np.array([beat.offset_information for beat in beats])
    t_s = t_s - t_s.mean()
    places = np.array([beat.place for beat in beats])
    steady = np.column_stack([places[:, None] == np.unique(places), t_s / t_s.std()]).astype(np.float64)
    constants = steady.shape[1] - 1
    without, _ = _fit(steady, constants, information, offsets)
    fastest_hz = 1.0 / (BEATS_A_BREATH * float(np.median(np.diff(t_s))))
    total = float(np.sum([beat.square for beat in beats]))
    best = Oscillation(0.0, 0.0, 0.0)
    slowest_hz = cycles / float(np.ptp(t_s))
    seen = (slowest_hz <= FREQUENCIES_HZ) & (fastest_hz >= FREQUENCIES_HZ)
    for frequency_hz in FREQUENCIES_HZ[seen].tolist():
        angle = 2.0 * np.pi * frequency_hz * t_s
        waves = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        explained, b_mm = _fit(np.hstack([steady, waves]), constants, information, offsets)
        free = 6 * len(beats) - b_mm.size
        fall = (explained - without) / max(1.0, (total - explained) / free)
        if fall > best.fall:
            amplitude_mm = float(np.linalg.norm(b_mm[-2:, 3:]))
            best = Oscillation(60.0 * frequency_hz, fall, amplitude_mm)
    return best


def _fit(
    features: FloatArray, constants: int, information: FloatArray, offsets: FloatArray
) -> tuple[float, FloatArray]:
    """Fit B (p, 6) of ξ = Bᵀ f by ridge, the first features `constants`; also return the χ² it explains."""
    count = features.shape[1]
    prior = np.repeat([*[CONSTANT_MM**-2.0] * constants, *[OSCILLATION_MM**-2.0] * (count - constants)], 6)
    matrix = normal_matrix(features, information) + np.diag(prior)
    right = (features.T @ offsets).ravel()
    solved = np.linalg.solve(matrix, right)
    return float(right @ solved), np.asarray(solved.reshape(count, 6), dtype=np.float64)
