"""From pre-operative surfaces or labels to the dynamic fixture model: Sections III and VI of Ren 2008."""

from .build import ModelOptions as ModelOptions
from .build import border_distance_mm as border_distance_mm
from .build import build_model as build_model
from .build import model_from_labels as model_from_labels
from .build import model_from_surfaces as model_from_surfaces
from .build import potential_at_border as potential_at_border
from .check import ModelCheck as ModelCheck
from .check import check_model as check_model
from .check import random_surface_points as random_surface_points
from .closing import close_surface as close_surface
from .distance import signed_distance_mm as signed_distance_mm
from .labels import border_caps as border_caps
from .labels import surfaces_from_labels as surfaces_from_labels
from .rasterise import rasterise as rasterise
from .spline_fit import AxisSolver as AxisSolver
from .spline_fit import fit_coefficients as fit_coefficients
from .triangle_tree import TriangleTree as TriangleTree
from .triangle_tree import build_triangle_tree as build_triangle_tree
