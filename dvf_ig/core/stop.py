"""Expected outcomes of an iterative estimate, which are not exceptions."""

from enum import Enum


class Stop(Enum):
    """Outcome of an iterative estimate; the value is the sentence that a user reads."""

    CONVERGED = "converged"
    MAX_ITERATIONS = "stopped at the iteration limit; the estimate may still be moving"
    MOVED_TOO_FAR = "the pose moved further from its start than a registration may; start closer and repeat"
    LOW_OVERLAP = "too little of the ultrasound falls on the model; sweep more of the heart or start closer"
    WEAK_GEOMETRY = "the data leave a direction undetermined; add views from other angles"
    AMBIGUOUS = "another pose explains the data about as well; add data or a start that tells them apart"
    POOR_MATCH = "image and model do not agree at the best pose found; do not guide by it"
    PHASE_OFFSET = "ECG and ultrasound disagree on the heart's phase; check the ECG's clock and latency"
    DOUBTFUL = "the checks together make a good pose too unlikely; do not guide by it"
    UNBOUNDED = (
        "nothing bounds the error of a heart that its images cover in part well enough to begin with it"
    )
    CHANGED_SHAPE = "the heart's shape differs too much from that in the pre-operative images to guide by it"
    DISAGREEMENT = "independent checks of the pose disagree; do not guide by it"

    @property
    def usable(self) -> bool:
        return self is Stop.CONVERGED
