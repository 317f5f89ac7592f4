"""Page and figures of a replayed intervention."""

from .page import replay_html as replay_html
from .values import BeatTrace as BeatTrace
from .values import BreathLoop as BreathLoop
from .values import EcgStrip as EcgStrip
from .values import RegistrationMark as RegistrationMark
from .values import ReplayPage as ReplayPage
from .values import SupervisorTrace as SupervisorTrace
from .values import TickTrace as TickTrace
