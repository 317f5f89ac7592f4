"""Images of the second world from scan lines' echoes: bloom, reverberation, gain, drop-out, grey curve."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from data_synth.seeds import child_rng, child_seed
from data_synth.threads import in_order
from data_synth.ultrasound.probe import SectorProbe
from data_synth.ultrasound.scan_conversion import ScanConverter
from data_synth.ultrasound.scan_lines import AcousticAnatomy, envelope_lines
from dvf_ig.core import FloatArray, Rigid, read_only_arrays

from .drawn import Drawn
from .probes import insonified

Echoes = NDArray[np.float32]
Report = Callable[[float], None]


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Dropout:
    """Lines that lose contact, or are in a shadow.

    Attributes:
        loss_db: (lines, samples) largest loss.
        turns_hz, start: rate at which it comes and goes, and its initial phase.
    """

    loss_db: FloatArray
    turns_hz: float
    start: float

    def at(self, t_s: float) -> FloatArray:
        share = np.clip(0.5 + 0.9 * np.sin(2 * np.pi * (self.turns_hz * t_s + self.start)), 0.0, 1.0)
        return np.asarray(share * self.loss_db)


@read_only_arrays
@dataclass(frozen=True, slots=True, eq=False)
class Display:
    """Conversion of echoes to grey levels by the scanner.

    Attributes:
        probe: nominal geometry of the scanner.
        gain_db: (lines, samples) errors of time gain and of lines.
        dropouts: see `Dropout`.
        values: values drawn.
    """

    probe: SectorProbe
    gain_db: FloatArray
    dropouts: tuple[Dropout, ...]
    values: Drawn

    def grey(self, level_db: Echoes, t_s: float) -> Echoes:
        """Convert echoes in dB relative to muscle at a time to (lines, samples) grey levels 0…255."""
        probe, drawn = self.probe, self.values
        shown = (
            20 * np.log10(np.maximum(self._bloomed(10 ** (level_db / np.float32(20))), 1e-8)) + self.gain_db
        )
        for dropout in self.dropouts:
            shown -= dropout.at(t_s)
        floor_db = probe.top_db - probe.dynamic_range_db
        share = np.clip((shown - floor_db) / probe.dynamic_range_db, 0.0, 1.0)
        bent = drawn["image.s_shape"]
        return np.asarray(255 * ((1 - bent) * share + bent * share**2 * (3 - 2 * share)), dtype=np.float32)

    def _bloomed(self, amplitude: Echoes) -> Echoes:
        """Add reverberation, and spread strong echoes along and across the beam."""
        probe, drawn = self.probe, self.values
        late = round(drawn["image.reverberation_mm"] / probe.step_mm)
        again = np.zeros_like(amplitude)
        again[:, late:] = 10 ** (drawn["image.reverberation_db"] / 20) * amplitude[:, :-late]
        out = np.hypot(amplitude, again)
        strong = np.maximum(out - np.float32(10 ** (drawn["image.bloom_above_db"] / 20)), 0)
        along = gaussian_filter1d(strong, drawn["image.bloom_axial_mm"] / probe.step_mm, axis=1)
        pitch_mm = 2 * probe.half_angle_rad / (probe.lines - 1) * 0.6 * probe.depth_mm
        spread = gaussian_filter1d(along, drawn["image.bloom_across_mm"] / pitch_mm, axis=0)
        return np.asarray(out + np.float32(2 * drawn["image.bloom_share"]) * spread, dtype=np.float32)


def drawn_display(probe: SectorProbe, drawn: Drawn) -> Display:
    """Draw the operator's sliders and the contact of the probe."""
    rng = child_rng(drawn.seed, "second world gain")
    knots = np.arange(0.0, probe.depth_mm + 60.0, drawn["image.time_gain_length_mm"])
    slides = CubicSpline(knots, drawn["image.time_gain_db"] * rng.standard_normal(len(knots)))
    across = np.linspace(0.0, 1.0, 6)
    lines = CubicSpline(across, drawn["image.line_gain_db"] * rng.standard_normal(6))
    gain = slides(probe.depths_mm)[None] + lines(np.linspace(0.0, 1.0, probe.lines))[:, None]
    count = round(drawn["image.dropouts"])
    return Display(probe, gain, tuple(_dropout(probe, drawn, i) for i in range(count)), drawn)


def _dropout(probe: SectorProbe, drawn: Drawn, number: int) -> Dropout:
    rng = child_rng(drawn.seed, f"second world dropout {number}")
    angle = np.rad2deg(probe.line_angles_rad)
    middle = rng.uniform(angle[0], angle[-1])
    width = drawn["image.dropout_deg"] * rng.uniform(0.6, 1.4)
    sideways = np.exp(-((np.abs(angle - middle) / (0.5 * width)) ** 4))
    begin = max(0.0, rng.uniform(-0.3, 0.6)) * probe.depth_mm
    deeper = np.clip((probe.depths_mm - begin) / 6.0, 0.0, 1.0) if begin else np.ones(probe.samples)
    loss = drawn["image.dropout_db"] * rng.uniform(0.6, 1.2) * sideways[:, None] * deeper[None]
    return Dropout(loss, drawn["image.dropout_hz"] * rng.uniform(0.5, 1.5), float(rng.uniform()))


def echo_images(
    hearts: Sequence[AcousticAnatomy],
    probe: SectorProbe,
    poses: list[Rigid],
    phases: FloatArray,
    t_s: FloatArray,
    drawn: Drawn,
    report: Report,
) -> NDArray[np.uint8]:
    """Simulate (n, rows, columns) images.

    Args:
        hearts: the heart at each image.
        poses: mr_from_plane of each image.
        phases: (n, lines) model phase of each line.
        t_s: (n,) times of the images.
    """
    display, converter = drawn_display(probe, drawn), ScanConverter.of(probe.polar, probe.pixels)
    true_probe = insonified(probe, drawn["image.sound_speed"])
    seed = child_seed(drawn.seed, "second world speckle")
    persistence = np.float32(drawn["image.persistence"])

    def make(i: int) -> Echoes:
        level = envelope_lines(hearts[i], true_probe, poses[i], phases[i], seed, i)
        return display.grey(level, float(t_s[i]))

    out = np.empty((len(poses), probe.rows, probe.columns), dtype=np.uint8)
    shown: Echoes | None = None
    for i, grey in enumerate(in_order(make, range(len(poses)))):
        shown = grey if shown is None else persistence * shown + (1 - persistence) * grey
        out[i] = converter(shown)
        report((i + 1) / len(poses))
    return out
