"""Page and figures of the registration study: accuracy, capture range, and whether failures are known."""

from .page import capture_html as capture_html
from .values import CapturePage as CapturePage
from .values import Reliability as Reliability
from .values import RocCurve as RocCurve
from .values import SuccessCurve as SuccessCurve
from .values import TrialGroup as TrialGroup
