"""Status codes of the real-time loop; `dvf_ig.guidance.Status` gives them their names."""

OK = 0
OUT_OF_VOLUME = 1
NO_PHASE = 2
NO_POSE = 3
STALE_TOOL = 4
FAULT = 5
