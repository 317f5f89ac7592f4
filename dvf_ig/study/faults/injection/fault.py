"""A fault: its begin and end, and what it changes in each stream of a session."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from data_synth.signals.rhythm import Beats
from dvf_ig.core import FloatArray, read_only_arrays
from dvf_ig.study.faults.known_ultrasound import Coordinates
from dvf_ig.study.faults.streams import Arrivals, TipPath


@dataclass(frozen=True, slots=True)
class When:
    """A fault's begin and end, s."""

    begin_s: float
    end_s: float


ArrivalsChange = Callable[[Arrivals, When], Arrivals]
SamplesChange = Callable[[FloatArray, When, np.random.Generator], FloatArray]
BeatsChange = Callable[[Beats, When, np.random.Generator], tuple[Beats, When]]
"""The beats with the fault, and from which R peak to which the rhythm is not regular."""
TipChange = Callable[[When], TipPath]
PatientChange = Callable[[When, np.random.Generator], Coordinates]


@read_only_arrays
@dataclass(frozen=True, slots=True)
class Fault:
    """What a fault does to each stream; None leaves it alone.

    Attributes:
        tool, frames, ecg: what arrives.
        samples: the ECG before it is cut into packets.
        beats: of the heart.
        tip: where the tip moves.
        patient: where the patient is.
        registered: where registrations put the patient.
    """

    tool: ArrivalsChange | None = None
    frames: ArrivalsChange | None = None
    ecg: ArrivalsChange | None = None
    samples: SamplesChange | None = None
    beats: BeatsChange | None = None
    tip: TipChange | None = None
    patient: PatientChange | None = None
    registered: PatientChange | None = None
