"""The table of hazards: every row of docs/theory/safety.md, and every member of `Hazard`."""

from .row import Row
from .servo_rows import SERVO_ROWS
from .session_rows import SESSION_ROWS
from .start_rows import START_ROWS

ROWS: tuple[Row, ...] = (*SESSION_ROWS, *SERVO_ROWS, *START_ROWS)
SEVERITIES = 3
