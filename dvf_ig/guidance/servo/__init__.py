"""The servo: pose, phase and fixtures to a supervised force at 1 to 4 kHz, without Python in between."""

from .inputs import ServoInputs as ServoInputs
from .options import ServoOptions as ServoOptions
from .record import Deadlines as Deadlines
from .record import SentForce as SentForce
from .record import ServoRecord as ServoRecord
from .record import ServoTick as ServoTick
from .servo import Servo as Servo
from .simulated_time import SimulatedServo as SimulatedServo
from .tracked import TrackedServo as TrackedServo
