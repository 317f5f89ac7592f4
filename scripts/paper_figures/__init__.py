"""Draw the figures of Ren 2008 from this package's model and laws, and one page of them with its tables.

Figs 3 to 5, 11 and 16 are slices, 7, 12 and 13 scenes, 8 to 10 laws, 14 and 15 tracking; also equations
10–11 over time, which the paper does not draw.
"""

from .over_time import force_over_time as force_over_time
from .over_time import over_time_figure as over_time_figure
from .page import PaperFigure as PaperFigure
from .page import PaperTable as PaperTable
from .page import paper_html as paper_html
from .page import write_paper_figures as write_paper_figures
from .potentials import exponent_figure as exponent_figure
from .potentials import steepness_figure as steepness_figure
from .potentials import width_figure as width_figure
from .scene import HeartView as HeartView
from .scene import Section as Section
from .scene import held_figure as held_figure
from .scene import scene_figure as scene_figure
from .slices import Slice as Slice
from .slices import dilation_distance_mm as dilation_distance_mm
from .slices import slice_figure as slice_figure
from .tracking import tracking_errors_figure as tracking_errors_figure
