"""Figures and HTML pages, drawn from values and arrays without computing estimates.

`registration`, `replay` and `viewer` hold what is shown of a registration and a replay; `style` and `page`
their common look. Callers compute what a figure shows and pass it as a value.
"""

from .gating import breathing_png as breathing_png
from .gating import gate_png as gate_png
from .motion import write_motion_picture as write_motion_picture
from .residuals import write_latency_picture as write_latency_picture
from .residuals import write_residual_picture as write_residual_picture
from .scenario import preview_png as preview_png
from .style import png_bytes as png_bytes
from .wires import write_wire_picture as write_wire_picture
