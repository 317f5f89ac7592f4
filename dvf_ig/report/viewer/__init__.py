"""Interactive viewer: scene, time series and live events as JSON, and the page that shows them."""

from .frames import FrameSeries as FrameSeries
from .frames import frame_event as frame_event
from .model import model_payload as model_payload
from .packing import packed as packed
from .page import live_page as live_page
from .page import viewer_html as viewer_html
from .registration import RegistrationView as RegistrationView
from .registration import registration_payload as registration_payload
from .scene import ImageShape as ImageShape
from .scene import SceneInput as SceneInput
from .scene import image_shape as image_shape
from .scene import scene_payload as scene_payload
from .series import Mark as Mark
from .series import SampledSignal as SampledSignal
from .series import SeriesInput as SeriesInput
from .series import series_payload as series_payload
from .series import state_event as state_event
