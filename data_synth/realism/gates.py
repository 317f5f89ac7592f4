"""Measured realism of the ultrasound: each figure with its bounds."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.optimize import curve_fit
from scipy.special import erfc
from scipy.stats import rayleigh

from data_synth.heart.motion_report import MotionReport
from data_synth.heart.tissue import ACOUSTICS, ANISOTROPY_DB, Tissue
from data_synth.ultrasound.probe import FWHM_PER_SIGMA, SectorProbe
from data_synth.ultrasound.scan_conversion import PixelGrid, PolarGrid, ScanConverter
from data_synth.ultrasound.scan_lines import form_beams
from data_synth.ultrasound.sequence import simulate_lines
from dvf_ig.core import FloatArray, Rigid

from .media import Medium, medium

STANDARD = SectorProbe(
    lines=192,
    samples=768,
    rows=512,
    columns=512,
    mm_per_px=(0.337, 0.337),
    apex_px=(255.5, 30.0),
    fine_lines=8,
)
"""Beam of the scenarios at the size for which a rate is stated: 192 lines of 768 samples to 512² pixels."""

PROBE = replace(STANDARD, noise_db=-140.0, tgc_db_per_cm_mhz=0.0)
"""`PROBE` without noise and gain."""

OBLIQUE = Rigid.from_rotation_vector((0.4, -0.7, 0.5), np.zeros(3), "mr", "plane")
FACING = Rigid.identity("mr", "plane")
DEPTHS_MM = (40.0, 80.0, 120.0)
CONTRASTS = (Tissue.LV_BLOOD, Tissue.FAT, Tissue.LIVER, Tissue.VALVE, Tissue.PERICARDIUM)
_BORDER_LINES = 15
_NEAR_SAMPLES = 150


@dataclass(frozen=True, slots=True)
class Gate:
    """Measured figure with the interval it must be in."""

    name: str
    value: float
    low: float
    high: float

    @property
    def passed(self) -> bool:
        return self.low <= self.value <= self.high


def near(name: str, value: float, target: float, tolerance: float) -> Gate:
    """Build a gate around a target value."""
    return Gate(name, value, target - tolerance, target + tolerance)


def envelope(anatomy: Medium, probe: SectorProbe = PROBE, *, seed: int = 3, frame: int = 0) -> FloatArray:
    """Simulate the (lines, samples) linear envelope, relative to myocardium."""
    level = simulate_lines(anatomy, probe, OBLIQUE, np.zeros(probe.lines), seed=seed, frame=frame)
    return np.asarray(10 ** (level.astype(np.float64) / 20))


def homogeneous(tissue: Tissue = Tissue.LV_MYOCARDIUM, *, seeds: int = 4) -> FloatArray:
    """Simulate (seeds, lines, samples) envelopes away from the sector's edges and the near field."""
    one = medium(tissue)
    frames = [envelope(one, seed=s, frame=s) for s in range(seeds)]
    return np.stack(frames)[:, _BORDER_LINES:-_BORDER_LINES, _NEAR_SAMPLES:-10]


def speckle_gates(envelopes: FloatArray) -> list[Gate]:
    """Check first-order statistics of fully developed speckle.

    The KS distance is taken on samples far enough apart to be independent, and compared with its 5 %
    critical value for a known scale, which is the larger one: the scale is fitted here.
    """
    power = envelopes**2
    decibel = 20 * np.log10(envelopes)
    apart = envelopes[:, ::6, ::8].ravel()
    scale = float(np.sqrt((apart**2).mean() / 2))
    ordered = np.sort(apart)
    model = rayleigh.cdf(ordered, scale=scale)
    steps = np.arange(len(ordered) + 1) / len(ordered)
    distance = max(np.max(steps[1:] - model), np.max(model - steps[:-1]))
    return [
        near("speckle SNR", float(envelopes.mean() / envelopes.std()), 1.91, 0.05),
        near("speckle sigma, dB", float(decibel.std()), 5.57, 0.2),
        near("Nakagami m", float(power.mean() ** 2 / power.var()), 1.0, 0.05),
        Gate("KS distance to Rayleigh x sqrt(n)", float(distance * np.sqrt(len(apart))), 0.0, 1.36),
    ]


def texture_gates(envelopes: FloatArray) -> list[Gate]:
    """Check the width of the envelope's autocovariance over the beam's and the pulse's.

    For a Gaussian beam the envelope's autocovariance is as wide as the beam's amplitude.
    """
    probe, gates = PROBE, []
    for depth_mm in DEPTHS_MM:
        middle = round(depth_mm / probe.step_mm) - _NEAR_SAMPLES
        band = envelopes[:, :, middle - 50 : middle + 50]
        pitch_mm = 2 * probe.half_angle_rad / (probe.lines - 1) * depth_mm
        lateral = _covariance_fwhm(band, 1) * pitch_mm / float(probe.lateral_fwhm_mm(depth_mm))
        gates.append(near(f"speckle / beam width at {depth_mm:.0f} mm", lateral, 1.0, 0.1))
    axial = _covariance_fwhm(envelopes, 2) * probe.step_mm / probe.axial_fwhm_mm
    return [*gates, near("speckle / pulse length", axial, 1.0, 0.1)]


def level_gates(envelopes: FloatArray) -> list[Gate]:
    """Check the mean power of myocardium, the zero of the decibel scale, along the depth."""
    power = np.mean(envelopes**2, axis=(0, 1))
    parts = np.array_split(10 * np.log10(power), len(DEPTHS_MM))
    return [
        near(f"myocardium's level in part {i} of the depth, dB", float(part.mean()), 0.0, 0.5)
        for i, part in enumerate(parts, start=1)
    ]


def contrast_gates() -> list[Gate]:
    """Check each tissue's mean echo relative to adjacent myocardium in the image against the table, dB."""
    gates, middle = [], PROBE.lines // 2
    for i, tissue in enumerate(CONTRASTS):
        halves = medium(Tissue.LV_MYOCARDIUM, tissue)
        level = simulate_lines(halves, PROBE, FACING, np.zeros(PROBE.lines), seed=i, frame=i)
        power = np.mean(10 ** (level[:, _NEAR_SAMPLES:-10].astype(np.float64) / 10), axis=1)
        measured = 10 * np.log10(
            power[middle + _BORDER_LINES :].mean() / power[: middle - _BORDER_LINES].mean()
        )
        table = ACOUSTICS[tissue].echo_db - ACOUSTICS[Tissue.LV_MYOCARDIUM].echo_db
        gates.append(near(f"{tissue.name.lower()} re myocardium, dB", float(measured), table, 1.0))
    return gates


def anisotropy_gate() -> Gate:
    """Check the loss of muscle whose wall is along the beam compared with muscle that faces it, dB."""
    levels = []
    for along_beam in (False, True):
        one = medium(Tissue.LV_MYOCARDIUM)
        # beams of the narrow probe run along y
        normal = np.array([1.0, 0.0, 0.0]) if along_beam else np.array([0.0, 1.0, 0.0])
        fibres = (np.sqrt(ANISOTROPY_DB) * normal).astype(np.float32).reshape(1, 1, 1, 3)
        probe = replace(PROBE, half_angle_rad=0.06)
        faced = replace(one, reference=replace(one.reference, fibre_orientation=fibres))
        level = simulate_lines(faced, probe, FACING, np.zeros(probe.lines), seed=5, frame=0)
        levels.append(10 * np.log10(np.mean(10 ** (level[:, _NEAR_SAMPLES:-10].astype(np.float64) / 10))))
    return near("muscle along the beam re facing it, dB", float(levels[1] - levels[0]), -ANISOTROPY_DB, 0.5)


def attenuation_gates() -> list[Gate]:
    """Check the slope of the mean power with depth over 2αf."""
    gates = []
    for tissue in (Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD):
        anatomy = medium(tissue, absorbing=True)
        power = np.mean([envelope(anatomy, seed=s, frame=s) ** 2 for s in range(4)], axis=(0, 1))
        depth_cm = PROBE.depths_mm / 10
        deep = depth_cm > 3
        slope = float(np.polyfit(depth_cm[deep], 10 * np.log10(power[deep]), 1)[0])
        expected = -2 * ACOUSTICS[tissue].attenuation_db * PROBE.frequency_mhz
        gates.append(near(f"attenuation / 2 alpha f, {tissue.name.lower()}", slope / expected, 1.0, 0.05))
    return gates


def point_gates(probe: SectorProbe = PROBE) -> list[Gate]:
    """Check the widths of a point target's image over the formulas, at three depths."""
    gates = []
    for depth_mm in DEPTHS_MM:
        image = point_image(depth_mm, probe)
        line, sample = (int(i) for i in np.unravel_index(image.argmax(), image.shape))
        pitch_mm = 2 * probe.half_angle_rad / (probe.lines - 1) * (probe.face_radius_mm + depth_mm)
        lateral = _fwhm(image[:, sample]) * pitch_mm / float(probe.lateral_fwhm_mm(depth_mm))
        axial = _fwhm(image[line]) * probe.step_mm / probe.axial_fwhm_mm
        gates.append(near(f"point lateral width / formula at {depth_mm:.0f} mm", lateral, 1.0, 0.1))
        gates.append(near(f"point axial width / formula at {depth_mm:.0f} mm", axial, 1.0, 0.1))
    return gates


def point_image(depth_mm: float, probe: SectorProbe = PROBE) -> FloatArray:
    """Simulate the (lines, samples) amplitude of a point in the middle of the sector."""
    rows = probe.lines * probe.fine_lines
    point = np.zeros((rows, 2 * probe.samples), dtype=np.float32)
    point[rows // 2, int(depth_mm / probe.step_mm)] = 1.0
    out = np.empty((probe.lines, probe.samples), dtype=np.float32)
    form_beams(probe, point, out)
    return out.astype(np.float64)


def elevation_gate(depth_mm: float = 80.0, planes: int = 9) -> Gate:
    """Check the slice width over the formula by the fading of power as the slice crosses a flat border.

    The power of a Gaussian beam across an edge is an error function of σ/√2.
    """
    probe = replace(PROBE, elevation_planes=planes, lines=48, half_angle_rad=0.3, fine_lines=4)
    formula = float(probe.elevation_fwhm_mm(depth_mm))
    anatomy = medium(Tissue.LV_MYOCARDIUM, Tissue.LV_BLOOD, axis=2)
    offsets = np.linspace(-1.2, 1.2, 25)
    around = np.abs(probe.depths_mm - depth_mm) < 8
    power = []
    for i, z in enumerate(offsets * formula):
        pose = Rigid("mr", "plane", np.eye(3), np.array([0.0, 0.0, z]))
        level = simulate_lines(anatomy, probe, pose, np.zeros(probe.lines), seed=i, frame=i)[:, around]
        power.append(float(np.mean(10 ** (level / 10))))

    def edge(z: FloatArray, top: float, middle: float, width: float) -> FloatArray:
        return np.asarray(0.5 * top * erfc((z - middle) / (width / FWHM_PER_SIGMA)))

    fitted, _ = curve_fit(edge, offsets, np.array(power), p0=(power[0], 0.0, 1.0))
    return near("slice thickness / formula", float(fitted[2]), 1.0, 0.1)


def _fwhm(profile: FloatArray) -> float:
    """Compute the full width at half maximum of a peak, in samples.

    The logarithm is interpolated, which is exact for a Gaussian of any number of samples.
    """
    peak = int(profile.argmax())
    high = profile > 0.02 * profile[peak]
    left = peak - int(np.argmin(high[peak::-1])) + 1
    right = peak + int(np.argmin(high[peak:]))
    place = np.arange(left, right)
    fine = np.linspace(left, right - 1, 20_001)
    curve = CubicSpline(place, np.log(profile[left:right]))(fine)
    return float((curve > curve.max() - np.log(2)).mean() * (right - 1 - left))


def _covariance_fwhm(stack: FloatArray, axis: int) -> float:
    """Compute the full width at half maximum, in samples, of the autocovariance along an axis."""
    centered = np.moveaxis(stack - stack.mean(), axis, 0)
    count = len(centered)
    half = np.array([np.mean(centered[: count - k] * centered[k:]) for k in range(14)])
    return _fwhm(np.maximum(np.concatenate([half[:0:-1], half]), 1e-9))


INFINITY = float("inf")


def heart_gates(motion: str, report: MotionReport) -> list[Gate]:
    """Check exactness for any motion, and physiological ranges or the 4.96 mm of "paper5mm"."""
    r = report
    gates = [
        Gate(f"{motion}: |det - 1| in the LV wall", r.wall_det_error, 0.0, 1e-6),
        Gate(f"{motion}: inverse error, mm", r.inverse_error_mm, 0.0, 0.05),
        Gate(f"{motion}: smallest Jacobian", r.det_min, 0.2, INFINITY),
    ]
    if motion == "paper5mm":
        return [*gates, Gate(f"{motion}: largest LV motion, mm", r.largest_lv_motion_mm, 4.7, 5.2)]
    return [
        *gates,
        Gate(f"{motion}: largest LV motion, mm", r.largest_lv_motion_mm, 10.0, 16.0),
        Gate(f"{motion}: LV ejection fraction", r.lv_ejection_fraction, 0.52, 0.72),
        Gate(f"{motion}: RV ejection fraction", r.rv_ejection_fraction, 0.40, 0.68),
        Gate(f"{motion}: LA expansion at ES", r.la_expansion, 0.15, 1.2),
        Gate(f"{motion}: wall thickening", r.wall_thickening, 0.25, 0.80),
        Gate(f"{motion}: long-axis shortening", r.long_axis_shortening, 0.10, 0.22),
    ]


REAL_LINES, REAL_SAMPLES = 96, 3640
REAL_POLAR = PolarGrid(REAL_LINES, REAL_SAMPLES, 10.0, 82.0, float(np.deg2rad(75.0)))
REAL_PIXELS = PixelGrid(616, 820, (0.15, 0.15), (410.0, 87.0 - 10.0 / 0.15))
"""Geometry of the PLUS test recording (Ultrasonix BPC8-4/10): the transducer's face at pixel (410, 87)."""


def real_pair_gates(polar: NDArray[np.uint8], converted: NDArray[np.uint8]) -> list[Gate]:
    """Check the smallest correlation over frames, inside the sector, of our and the recorded conversion.

    Args:
        polar: (n, 96, 3640) recorded lines.
        converted: (n, 616, 820) the recorder's conversion.
    """
    convert = ScanConverter.of(REAL_POLAR, REAL_PIXELS)
    inside = convert.line >= 0
    scores = [
        float(np.corrcoef(convert(lines.astype(np.float32))[inside], image[inside])[0, 1])
        for lines, image in zip(polar, converted, strict=True)
    ]
    return [Gate("scan conversion, r with the real pair", min(scores), 0.95, 1.0)]
