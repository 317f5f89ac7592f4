"""Page of one registration: its outcome, fused planes, evidence and transform."""

from .page import registration_html as registration_html
from .values import Check as Check
from .values import Outcome as Outcome
from .values import RegistrationPage as RegistrationPage
from .values import Transform as Transform
