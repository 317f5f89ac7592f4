"""Course of breathing over time: breaths of a ventilator or of the patient, and what can happen to them."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.signal import lfilter

from dvf_ig.core import FloatArray, InvalidInputError, read_only_arrays

BreathKind = Literal["ventilated", "spontaneous"]
BreathEvent = Literal["sigh", "cough", "pause", "disconnection", "doubled-rate", "deepened"]

GRID_S = 0.01
WARM_UP_S = 30.0
"""Breathing before time 0, so that hysteresis has settled."""

INSPIRATION_SHARE = 1.0 / 3.0
"""Share of a ventilated breath in which the lung fills at constant flow (I:E 1:2)."""
EMPTYING_S = 0.55
"""Time constant of passive expiration: resistance times compliance."""

VARIATION: dict[BreathKind, tuple[float, float]] = {"ventilated": (0.03, 0.01), "spontaneous": (0.12, 0.06)}
"""Relative SD of depth and period from breath to breath."""

SIGH_DEPTH = 1.8
PAUSE_S = 12.0
DISCONNECTION_S = 12.0
DISCONNECTED_VOLUME = -0.15
"""Volume, as a share of a breath, that the lung loses below end-expiration without the ventilator's PEEP."""
COUGH_S = 0.12
COUGHS = (0.0, 0.45, 0.9)


@dataclass(frozen=True, slots=True)
class BreathSpec:
    """Breathing of a scenario.

    Attributes:
        kind: ventilated (constant flow, passive expiration) or spontaneous (cos⁴, Lujan 1999).
        excursion_mm: motion of the heart's centre from end-expiration to end-inspiration; 0: no breathing,
            as with high-frequency ventilation.
        per_minute: breaths a minute.
        tilt_deg: turn of the heart at end-inspiration; it lags in its own way.
        stretch_mm, nonrigid_mm: affine and other change of shape at end-inspiration, RMS at the heart's
            surface, which no rigid pose holds.
        lagging: share of the motion that follows the breath through a lag (hysteresis that depends on rate).
        backlash: width, as a share of a breath, of the hysteresis that does not depend on rate.
        events: (event, time s) pairs.
        recorded: something follows the breath; without, only the ECG shows it.
    """

    kind: BreathKind = "ventilated"
    excursion_mm: float = 0.0
    per_minute: float = 14.0
    tilt_deg: float = 2.5
    stretch_mm: float = 0.55
    nonrigid_mm: float = 0.3
    lagging: float = 0.5
    backlash: float = 0.04
    events: tuple[tuple[BreathEvent, float], ...] = ()
    recorded: bool = True

    def __post_init__(self) -> None:
        if self.kind not in get_args(BreathKind):
            raise InvalidInputError(
                f"breathing is '{self.kind}'; choose from {', '.join(get_args(BreathKind))}"
            )
        if not 0.0 <= self.excursion_mm <= 40.0 or not 2.0 <= self.per_minute <= 60.0:
            raise InvalidInputError(
                f"breathing is {self.excursion_mm:g} mm, {self.per_minute:g} a minute; "
                "needed 0 to 40 mm and 2 to 60 a minute"
            )
        sizes = (self.tilt_deg, self.stretch_mm, self.nonrigid_mm)
        if not 0.0 <= min(sizes) <= max(sizes) <= 15.0:
            raise InvalidInputError("a tilt or change of shape by breathing is outside 0 to 15 (deg or mm)")
        if not 0.0 <= self.lagging <= 1.0 or not 0.0 <= self.backlash <= 1.0:
            raise InvalidInputError("the hysteresis of breathing is outside 0 to 1")
        for event, _ in self.events:
            if event not in get_args(BreathEvent):
                raise InvalidInputError(
                    f"breathing has no event '{event}'; choose from {', '.join(get_args(BreathEvent))}"
                )

    @property
    def moves(self) -> bool:
        return self.excursion_mm > 0


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Breaths:
    """Course of breathing on a regular grid.

    Attributes:
        t_s: (n,) from WARM_UP_S before 0 on, GRID_S apart.
        volume: (n,) of the lung above end-expiration; 1 is an ordinary breath.
        connected: (n,) False while the ventilator is disconnected.
    """

    t_s: FloatArray
    volume: FloatArray
    connected: FloatArray

    def volume_at(self, t_s: float) -> float:
        """Interpolate the volume."""
        return float(np.interp(t_s, self.t_s, self.volume))


def draw_breaths(spec: BreathSpec, seconds: float, rng: np.random.Generator) -> Breaths:
    """Draw breaths until 3 s after `seconds`."""
    t_s = np.arange(-WARM_UP_S, seconds + 3.0, GRID_S)
    volume, connected = np.zeros(len(t_s)), np.ones(len(t_s))
    depth_sd, period_sd = VARIATION[spec.kind]
    times = dict(spec.events)
    begin_s, kept, sighed, paused = (
        -WARM_UP_S - float(rng.uniform(0.0, 60.0 / spec.per_minute)),
        0.0,
        False,
        False,
    )
    while begin_s < t_s[-1]:
        period_s = 60.0 / spec.per_minute * (1.0 + period_sd * float(rng.standard_normal()))
        depth = max(0.2, 1.0 + depth_sd * float(rng.standard_normal()))
        if begin_s >= times.get("doubled-rate", np.inf):
            period_s *= 0.5
        if begin_s >= times.get("deepened", np.inf):
            depth *= SIGH_DEPTH
        if not sighed and begin_s >= times.get("sigh", np.inf):
            depth, sighed = depth * SIGH_DEPTH, True
        inside = (t_s >= begin_s) & (t_s < begin_s + period_s)
        since_s = t_s[inside] - begin_s
        if spec.kind == "ventilated":
            volume[inside], kept = _ventilated(since_s, period_s, depth, kept)
        else:
            volume[inside] = depth * np.cos(np.pi * (since_s / period_s - 0.5)) ** 4
        begin_s += period_s
        if not paused and begin_s >= times.get("pause", np.inf):
            paused = True
            still = (t_s >= begin_s) & (t_s < begin_s + PAUSE_S)
            volume[still] = kept * np.exp(-(t_s[still] - begin_s) / EMPTYING_S)
            begin_s, kept = begin_s + PAUSE_S, 0.0
    for event, at_s in spec.events:
        if event == "cough":
            volume += sum(
                0.7 * (-1.0) ** i * np.exp(-0.5 * ((t_s - at_s - late_s) / COUGH_S) ** 2)
                for i, late_s in enumerate(COUGHS)
            )
        if event == "disconnection":
            off = (t_s >= at_s) & (t_s < at_s + DISCONNECTION_S)
            start = float(np.interp(at_s, t_s, volume))
            falling = np.exp(-(t_s[off] - at_s) / EMPTYING_S)
            volume[off] = DISCONNECTED_VOLUME + (start - DISCONNECTED_VOLUME) * falling
            connected[off] = 0.0
    return Breaths(t_s, lagged(volume, 0.05), connected)


def _ventilated(since_s: FloatArray, period_s: float, depth: float, kept: float) -> tuple[FloatArray, float]:
    """Fill at constant flow from what the last breath left, then empty; also return what remains."""
    filling_s = INSPIRATION_SHARE * period_s
    top = kept + depth
    rising = kept + depth * np.minimum(since_s / filling_s, 1.0)
    falling = top * np.exp(-np.maximum(since_s - filling_s, 0.0) / EMPTYING_S)
    volume = np.where(since_s < filling_s, rising, falling)
    return volume, top * float(np.exp(-(period_s - filling_s) / EMPTYING_S))


def lagged(values: FloatArray, tau_s: float) -> FloatArray:
    """Apply a first-order lag to (n,) values on the grid."""
    share = 1.0 - float(np.exp(-GRID_S / tau_s))
    return np.asarray(lfilter([share], [1.0, share - 1.0], values, zi=[(1.0 - share) * values[0]])[0])


def with_backlash(values: FloatArray, width: float) -> FloatArray:
    """Apply play of `width`: the result follows only when pushed by either side, at any rate."""
    out, at = np.empty_like(values), float(values[0])
    for i, value in enumerate(values.tolist()):
        at = min(max(at, value - width), value)
        out[i] = at
    return out
