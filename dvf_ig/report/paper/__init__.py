"""Draw the figures and Table II of Ren 2008 from this package's model and laws, with the paper's numbers.

Fig. 4 fitted surface, Figs 5 and 11 force fields, Figs 8 to 10 potentials, Fig. 14 automatic tracking
(`dvf_ig.study.tracking`); also equations 10–11 over time, which the paper does not draw.
"""

from .fields import field_figure as field_figure
from .fields import organ_field as organ_field
from .fields import surface_field as surface_field
from .over_time import force_over_time as force_over_time
from .over_time import over_time_figure as over_time_figure
from .page import PaperFigure as PaperFigure
from .page import paper_html as paper_html
from .page import write_paper_figures as write_paper_figures
from .potentials import exponent_figure as exponent_figure
from .potentials import steepness_figure as steepness_figure
from .potentials import width_figure as width_figure
from .surface import SurfaceFit as SurfaceFit
from .surface import surface_figure as surface_figure
from .surface import surface_fit as surface_fit
