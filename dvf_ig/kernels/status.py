"""Status codes of the servo loop; `dvf_ig.guidance.Status` names and explains them."""

OK = 0
OUT_OF_VOLUME = 1
NO_PHASE = 2
NO_POSE = 3
STALE_TOOL = 4
FAULT = 5
UNSEEN = 6
