"""What a session publishes to the servo: one array, at these offsets."""

from dvf_ig.kernels.place import PACKED_SIZE

MAX_FIXTURES = 8

# Offsets in what a session publishes. Only pose and phase live in the session's time: what fades, latches or
# times out runs by the servo's own clock, which no session can set back.
VALID_UNTIL_S = 0
"""By the servo's clock."""
HAZARDS = 1
TOOL_STATUS = 2
CLOCK_OFFSET_S = 3
TRACKER_FROM_DEVICE = 4
MARGIN_MM = 16
POSE_AND_PHASE = MARGIN_MM + MAX_FIXTURES
INPUT_SIZE = POSE_AND_PHASE + PACKED_SIZE
