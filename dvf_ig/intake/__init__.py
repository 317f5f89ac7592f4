"""A lab's files made ready for a session: its calibrations, and the pose that registration starts from."""

from .calibrations import Calibrations as Calibrations
from .calibrations import calibrate as calibrate
from .calibrations import calibrated as calibrated
from .start import landmark_pose as landmark_pose
from .start import landmark_prior as landmark_prior
from .start import landmarks_start as landmarks_start
from .start import require_start as require_start
from .start import start_pose as start_pose
from .start import touched_surface as touched_surface
