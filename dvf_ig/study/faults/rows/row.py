"""One row of the table of hazards: a fault at three severities, and when each must be detected."""

from dataclasses import dataclass

from dvf_ig.guidance import Hazard
from dvf_ig.study.faults.servo_trial import ServoFault
from dvf_ig.study.faults.session_trial import SessionFault
from dvf_ig.study.faults.start_trial import StartFault


@dataclass(frozen=True, slots=True)
class Severity:
    """One severity of a fault.

    Attributes:
        label: what is done, as a reader sees it.
        fault: the same for the trial.
        limit_s: within which it must be detected, from its begin.
    """

    label: str
    fault: SessionFault | ServoFault | StartFault
    limit_s: float


@dataclass(frozen=True, slots=True)
class Row:
    """One row.

    Attributes:
        name: of the hazard, as docs/theory/safety.md has it, and what is disturbed.
        hazards: any of which detects the fault; NONE where a start is to be refused.
        limit: how the time limit follows from docs/theory/safety.md.
        severities: three, the least first, which lies just above what must be detected.
    """

    name: str
    hazards: Hazard
    limit: str
    severities: tuple[Severity, Severity, Severity]
