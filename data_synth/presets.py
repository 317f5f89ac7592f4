"""What a synthetic intervention is like: named presets of rhythm, disturbances and errors."""

from dataclasses import dataclass, field
from typing import Literal, get_args

from dvf_ig.core import InvalidInputError

from .ecg import EcgSpec
from .nwire import NWireSpec
from .probe_path import SweepSpec
from .rhythm import RhythmSpec
from .tool_path import ToolSpec
from .tracker import TrackerSpec
from .watertank import WaterTankSpec

Motion = Literal["paper5mm", "physiological"]
MOTIONS: tuple[Motion, ...] = get_args(Motion)


@dataclass(frozen=True, slots=True)
class Preset:
    """Everything a preset fixes; the defaults are the calm one.

    Attributes:
        rhythm, ecg, sweep, tool, nwire, watertank: see their classes.
        probe_tracker, tool_tracker: errors of the two sensors in the live part.
        pivot_tracker, watertank_tracker: the same in these calibration recordings.
        mismatch_mm: RMS non-rigid difference between pre-operative and intra-operative anatomy.
        video_jitter_s: SD of the instants at which images are taken, about the regular grid.
        start_mm, start_deg: how far the coarse start is off.
    """

    rhythm: RhythmSpec = field(default_factory=RhythmSpec)
    ecg: EcgSpec = field(default_factory=EcgSpec)
    sweep: SweepSpec = field(default_factory=SweepSpec)
    tool: ToolSpec = field(default_factory=ToolSpec)
    nwire: NWireSpec = field(default_factory=NWireSpec)
    watertank: WaterTankSpec = field(default_factory=WaterTankSpec)
    probe_tracker: TrackerSpec = field(
        default_factory=lambda: TrackerSpec(rate_hz=12.0, dropouts_per_min=1.0)
    )
    tool_tracker: TrackerSpec = field(
        default_factory=lambda: TrackerSpec(
            rate_hz=100.0, position_mm=0.1, rotation_deg=0.05, dropouts_per_min=2.0
        )
    )
    pivot_tracker: TrackerSpec = field(
        default_factory=lambda: TrackerSpec(rate_hz=20.0, position_mm=0.1, rotation_deg=0.05)
    )
    watertank_tracker: TrackerSpec = field(default_factory=lambda: TrackerSpec(rate_hz=50.0))
    mismatch_mm: float = 1.2
    video_jitter_s: float = 0.001
    start_mm: float = 10.0
    start_deg: float = 8.0


PRESETS: dict[str, Preset] = {"calm": Preset()}
"""calm: about 72 beats/min with mild variability, low noise, short drop-outs."""


@dataclass(frozen=True, slots=True)
class ScenarioSpec:
    """One synthetic scenario; the same values give bit-identical recordings.

    Attributes:
        preset: a key of PRESETS.
        motion: how far the phantom's heart moves: "paper5mm" or "physiological".
        seconds: length of the live part.
        seed: of every random choice, a non-negative integer.
        us_rate_hz: ultrasound frame rate.
        mismatch_mm: overrides the preset's mismatch.
    """

    preset: str = "calm"
    motion: Motion = "paper5mm"
    seconds: float = 60.0
    seed: int = 1
    us_rate_hz: float = 12.0
    mismatch_mm: float | None = None

    def __post_init__(self) -> None:
        if self.preset not in PRESETS:
            raise InvalidInputError(f"there is no preset '{self.preset}'; choose from {', '.join(PRESETS)}")
        if self.motion not in MOTIONS:
            raise InvalidInputError(f"there is no motion '{self.motion}'; choose from {', '.join(MOTIONS)}")
        if not 5.0 <= self.seconds <= 3600.0:
            raise InvalidInputError(f"the scenario is to last {self.seconds:g} s; needed 5 to 3600 s")
        if not 6.0 <= self.us_rate_hz <= 60.0:
            raise InvalidInputError(
                f"ultrasound rate is {self.us_rate_hz:g} Hz; needed 6 to 60 Hz (poses are recorded with the "
                "images, and slower ones cannot be interpolated)"
            )
        if self.seed < 0:
            raise InvalidInputError(f"the seed is {self.seed}; needed a non-negative integer")
        if self.mismatch_mm is not None and not 0.0 <= self.mismatch_mm <= 10.0:
            raise InvalidInputError(f"mismatch is {self.mismatch_mm:g} mm; needed 0 to 10 mm")

    @property
    def options(self) -> Preset:
        return PRESETS[self.preset]

    @property
    def mismatch(self) -> float:
        """Mismatch in mm that holds."""
        return self.options.mismatch_mm if self.mismatch_mm is None else self.mismatch_mm
