"""Echo amplitudes along each scan line: absorption, interfaces, muscle fibres, reverberation.

These are the first kernels of a frame; `speckle` and `receive` follow.
"""

from typing import NamedTuple

import numpy as np

from dvf_ig.core import AnyArray

from .compiled import kernel
from .interpolation import Point, channels_at, nearest

TOTAL_REFLECTION = 0.5
"""Reflection coefficient above which an interface is a total reflector: lung or bone."""

ECHO_REACH = 8
"""Samples before and after a reflector that belong to its echo."""

_DIRTY_SHADOW_MM = 20.0


class TissueFields(NamedTuple):
    """Tissue map in the form that kernels read.

    Attributes:
        acoustics: (nx, ny, nz, 5) float32: ln Z, α in dB/cm/MHz, echo amplitude of tissue and of blood, and
            |∇ ln Z| per mm.
        origin: (3,) first node.
        per_mm: nodes a millimetre.
        fibres: (mx, my, mz, 3) float32 wall normals on a coarser grid from the same origin, see
            `fibre_orientation`.
        fibres_per_mm: nodes a millimetre of that grid.
    """

    acoustics: AnyArray
    origin: AnyArray
    per_mm: float
    fibres: AnyArray
    fibres_per_mm: float


class Pulse(NamedTuple):
    """Pulse that is sent along a line.

    Attributes:
        step_mm: depth between samples.
        frequency_mhz: centre frequency.
        specular: amplitude factor of an interface's echo relative to its reflection coefficient.
        specular_power: exponent of the cosine between beam and interface normal.
    """

    step_mm: float
    frequency_mhz: float
    specular: float
    specular_power: float


class Amplitudes(NamedTuple):
    """Amplitudes that return from each sample of each line.

    Attributes:
        tissue, blood: (lines, samples) float32 scatter amplitudes.
        interface: (lines, samples) float32 specular amplitude.
        reflector: (lines, 3) sample of the first total reflector (−1: none), its reflection coefficient, and
            the two-way amplitude that reaches it.
    """

    tissue: AnyArray
    blood: AnyArray
    interface: AnyArray
    reflector: AnyArray


@kernel(nogil=True, error_model="numpy")
def insonify(path: AnyArray, fields: TissueFields, pulse: Pulse, out: Amplitudes) -> None:
    """Compute the amplitudes that return from each sample of each line into `out`.

    Args:
        path: (lines, samples + 1, 3) reference positions of the ends of the samples.
    """
    for line in range(len(path)):
        _insonify_line(
            path[line], fields, pulse, out.tissue[line], out.blood[line], out.interface[line],
            out.reflector[line],
        )  # fmt: skip


@kernel(nogil=True, error_model="numpy")
def _insonify_line(
    path: AnyArray,
    fields: TissueFields,
    pulse: Pulse,
    tissue: AnyArray,
    blood: AnyArray,
    interface: AnyArray,
    reflector: AnyArray,
) -> None:
    """Compute one line of `insonify`.

    Loss accumulates along the line: absorption 2αf, and at each interface the transmission 1 − R² once, with
    R = tanh(½ Δ ln Z) over the whole monotone rise of ln Z. The integral of ∇ln Z along a line does not
    depend on the angle at which it crosses an interface, so the reflected part returns in proportion to the
    cosine between beam and interface normal, to the given power.
    """
    # arrays are taken out of the tuple once: each access counts a reference
    acoustics, origin, fibres = fields.acoustics, fields.origin, fields.fibres
    absorb = -2.0 * pulse.frequency_mhz * 0.1 * pulse.step_mm * np.log(10.0) / 20.0
    loss, passed, run, last, transmitted = 0.0, 1.0, 0.0, 0.0, 1.0
    reflector[0] = -1.0
    for i in range(len(tissue)):
        x, y, z = _middle(path, i)
        impedance, alpha, muscle, plasma, slope = channels_at(x, y, z, acoustics, origin, fields.per_mm)
        rise = impedance - last if i > 0 else 0.0
        last = impedance
        if rise * run < 0.0 or abs(rise) < 1e-5:
            passed *= transmitted
            run, transmitted = 0.0, 1.0
        loss += absorb * alpha
        level = np.exp(loss)
        interface[i] = 0.0
        after = 0.0
        if run + rise != 0.0:
            before = np.tanh(0.5 * run)
            run += rise
            after = np.tanh(0.5 * run)
            transmitted = 1.0 - after * after
            facing = min(abs(rise) / (slope * pulse.step_mm + 1e-6), 1.0)
            interface[i] = (
                pulse.specular * abs(after - before) * facing**pulse.specular_power * level * passed
            )
        if muscle > 0.0:
            muscle *= _fibre_factor(x, y, z, path, i, fibres, origin, fields.fibres_per_mm)
        tissue[i] = muscle * level * passed * transmitted
        blood[i] = plasma * level * passed * transmitted
        if reflector[0] < 0.0 and abs(after) > TOTAL_REFLECTION:
            reflector[0], reflector[1], reflector[2] = i, after, level * passed


@kernel(nogil=True, error_model="numpy", inline="always")
def _middle(path: AnyArray, i: int) -> Point:
    return (
        0.5 * (path[i, 0] + path[i + 1, 0]),
        0.5 * (path[i, 1] + path[i + 1, 1]),
        0.5 * (path[i, 2] + path[i + 1, 2]),
    )


@kernel(nogil=True, error_model="numpy")
def _fibre_factor(
    x: float,
    y: float,
    z: float,
    path: AnyArray,
    i: int,
    fibres: AnyArray,
    origin: AnyArray,
    fibres_per_mm: float,
) -> float:
    """Compute muscle's amplitude factor: scatter drops by sin² of beam and wall normal, in dB."""
    a = nearest((x - origin[0]) * fibres_per_mm, fibres.shape[0])
    b = nearest((y - origin[1]) * fibres_per_mm, fibres.shape[1])
    c = nearest((z - origin[2]) * fibres_per_mm, fibres.shape[2])
    gx, gy, gz = fibres[a, b, c, 0], fibres[a, b, c, 1], fibres[a, b, c, 2]
    drop_db = gx * gx + gy * gy + gz * gz
    if drop_db <= 0.0:
        return 1.0
    dx, dy, dz = (path[i + 1, 0] - path[i, 0], path[i + 1, 1] - path[i, 1], path[i + 1, 2] - path[i, 2])
    along = gx * dx + gy * dy + gz * dz
    rest_db = drop_db - along * along / (dx * dx + dy * dy + dz * dz + 1e-12)
    return float(10.0 ** (-0.05 * rest_db))


@kernel(nogil=True, error_model="numpy")
def reverberate(amplitudes: Amplitudes, step_mm: float, face: float, dirty: float) -> None:
    """Add the late echoes of a total reflector to the amplitudes of tissue and interfaces.

    The pulse bounces between reflector and transducer, so its echo comes back at every multiple of the
    reflector's depth, each time reduced by the face's reflection and the two-way path. Air also returns
    clutter that dies out over some 20 mm (a dirty shadow); the shadow of bone stays clean.

    Args:
        face: amplitude that the transducer's face reflects.
        dirty: amplitude of the clutter behind air, relative to the amplitude that reaches it.
    """
    reflector, tissue, interface = amplitudes.reflector, amplitudes.tissue, amplitudes.interface
    samples = interface.shape[1]
    for line in range(len(reflector)):
        i = int(reflector[line, 0])
        if i < 0:
            continue
        if reflector[line, 1] < 0.0:
            for j in range(i, samples):
                tissue[line, j] += dirty * reflector[line, 2] * np.exp(-(j - i) * step_mm / _DIRTY_SHADOW_MM)
        trip = face * abs(reflector[line, 1]) * reflector[line, 2]
        bounce, size = 2, trip
        while i > 2 * ECHO_REACH and bounce * i + bounce // 2 - ECHO_REACH < samples and size > 1e-6:
            center = bounce * i + bounce // 2
            for w in range(-ECHO_REACH, min(ECHO_REACH + 1, samples - center)):
                if i + w < samples:
                    interface[line, center + w] += size * interface[line, i + w]
            bounce, size = bounce + 1, size * trip
