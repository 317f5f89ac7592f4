"""B-mode images of a beating synthetic heart."""

from collections.abc import Callable, Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from data_synth.threads import THREADS, in_order
from dvf_ig.core import FloatArray, InvalidInputError, Rigid

from .probe import SectorProbe
from .scan_conversion import ScanConverter
from .scan_lines import AcousticAnatomy, envelope_lines

Progress = Callable[[int, int], None]


def simulate_frame(
    anatomy: AcousticAnatomy,
    probe: SectorProbe,
    mr_from_plane: Rigid,
    line_phases: FloatArray,
    *,
    seed: int,
    frame: int,
) -> NDArray[np.uint8]:
    """Simulate one B-mode image, (rows, columns).

    Args:
        mr_from_plane: pose of the image plane ("plane" as defined by `SectorProbe`).
        line_phases: (lines,) model phase at which each line was acquired.
        seed: seed of the scatterers; the same heart and seed give the same speckle in every frame.
        frame: number of the frame; blood and receiver noise are redrawn with it.
    Raises:
        InvalidInputError: wrong number of line phases, or a non-finite one.
        FrameMismatchError: the pose is not mr_from_plane.
    """
    level = simulate_lines(anatomy, probe, mr_from_plane, line_phases, seed=seed, frame=frame)
    return _converter(probe)(log_compressed(level, probe))


def simulate_lines(
    anatomy: AcousticAnatomy,
    probe: SectorProbe,
    mr_from_plane: Rigid,
    line_phases: FloatArray,
    *,
    seed: int,
    frame: int,
) -> NDArray[np.float32]:
    """Simulate the envelope before log compression and scan conversion: (lines, samples), dB.

    Arguments and errors as in `simulate_frame`.
    """
    phases = checked_phases(line_phases, (probe.lines,))
    return envelope_lines(anatomy, probe, mr_from_plane, phases, seed, frame)


def simulate_sequence(
    anatomy: AcousticAnatomy | Sequence[AcousticAnatomy],
    probe: SectorProbe,
    mr_from_plane: Sequence[Rigid],
    line_phases: FloatArray,
    *,
    seed: int,
    progress: Progress | None = None,
    threads: int = THREADS,
) -> NDArray[np.uint8]:
    """Simulate (frames, rows, columns) images, bit-identical for any number of threads.

    Args:
        anatomy: the heart, or the heart at each frame.
        mr_from_plane: pose of the image plane for each frame.
        line_phases: (frames, lines) model phases.
        progress: called with (frames done, total frames).
    Raises:
        InvalidInputError: phases do not match the poses.
    """
    phases = checked_phases(line_phases, (len(mr_from_plane), probe.lines))
    # cached values are filled before threads share them
    hearts = anatomy if isinstance(anatomy, Sequence) else [anatomy] * len(mr_from_plane)
    _ = [(heart.reference, heart.inverse_motion) for heart in hearts[:1]]
    convert, persistence = _converter(probe), np.float32(probe.persistence)
    out = np.empty((len(mr_from_plane), probe.rows, probe.columns), dtype=np.uint8)

    def make(i: int) -> NDArray[np.float32]:
        level = envelope_lines(hearts[i], probe, mr_from_plane[i], phases[i], seed, i)
        return log_compressed(level, probe)

    shown: NDArray[np.float32] | None = None
    for i, grey in enumerate(in_order(make, range(len(out)), threads)):
        shown = grey if shown is None or persistence == 0 else persistence * shown + (1 - persistence) * grey
        out[i] = convert(shown)
        if progress is not None:
            progress(i + 1, len(out))
    return out


def log_compressed(level_db: NDArray[np.float32], probe: SectorProbe) -> NDArray[np.float32]:
    """Convert an envelope in dB to grey levels 0…255."""
    floor_db = np.float32(probe.top_db - probe.dynamic_range_db)
    grey = (level_db - floor_db) * np.float32(255 / probe.dynamic_range_db)
    return np.asarray(np.clip(grey, 0, 255), dtype=np.float32)


def checked_phases(line_phases: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    """Check line phases and convert them to float64.

    Raises:
        InvalidInputError: another shape than one for each scan line, or not finite.
    """
    phases = np.asarray(line_phases, dtype=np.float64)
    if phases.shape != shape or not np.isfinite(phases).all():
        raise InvalidInputError(
            f"line phases have shape {phases.shape}; needed {shape} finite values, one for each scan line"
        )
    return phases


@lru_cache(maxsize=8)
def _converter(probe: SectorProbe) -> ScanConverter:
    return ScanConverter.of(probe.polar, probe.pixels)
