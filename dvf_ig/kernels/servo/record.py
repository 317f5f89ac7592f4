"""One row of the servo's record: what a tick saw, wanted and sent."""

from dvf_ig.core import FloatArray
from dvf_ig.kernels.compiled import inlined

from . import passivity, supervision

# Columns of a row of the record.
T_S = 0
XYZ_MM = 1
FIELD_N = 4
WANTED_N = 7
SENT_N = 10
DISTANCE_MM = 13
SIGMA_MM = 14
SURFACE_MM_S = 15
STATUS = 16
STATE = 17
ACTIVE_HAZARDS = 18
CAUSE = 19
SCALE = 20
CLAMPED = 21
IN_CONFLICT = 22
RESIDUAL_MJ = 23
GIVEN_MJ = 24
BY_SURFACE_MJ = 25
CONTROLLER_DAMPING = 26
LATENESS_NS = 27
WORK_NS = 28
TICK = 29
ROW = 30


@inlined
def record_supervision(row: FloatArray, supervisor: FloatArray) -> None:
    """The supervisor's state after the tick, from its memory."""
    row[STATE], row[SCALE] = supervisor[supervision.STATE], supervisor[supervision.SCALE]
    row[ACTIVE_HAZARDS], row[CAUSE] = supervisor[supervision.HAZARDS], supervisor[supervision.CAUSE]
    row[CLAMPED] = supervisor[supervision.CLAMPED]


@inlined
def record_energy(row: FloatArray, memory: FloatArray) -> None:
    """What the passivity observer knows after the tick, from the tick's memory."""
    row[RESIDUAL_MJ], row[GIVEN_MJ] = memory[passivity.RESIDUAL], memory[passivity.GIVEN]
    row[BY_SURFACE_MJ], row[CONTROLLER_DAMPING] = memory[passivity.BY_SURFACE], memory[passivity.DAMPING]
