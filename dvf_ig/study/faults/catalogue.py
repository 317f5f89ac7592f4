"""The table of hazards: every row of docs/theory/safety.md, and every member of `Hazard`."""

from .rows.clocks import CLOCK_ROWS
from .rows.heart import PHASE_ROWS
from .rows.pose import POSE_ROWS
from .rows.row import Row
from .rows.servo import SERVO_ROWS
from .rows.start import START_ROWS
from .rows.tool import TOOL_ROWS

ROWS: tuple[Row, ...] = (*TOOL_ROWS, *PHASE_ROWS, *POSE_ROWS, *CLOCK_ROWS, *SERVO_ROWS, *START_ROWS)
SEVERITIES = 3
