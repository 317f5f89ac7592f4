"""Sphinx settings of the documentation: Markdown pages, formulas as SVG, API read from docstrings.

The packages are parsed, never imported. Nothing is loaded from a network.
"""

import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
sys.path.insert(0, str(HERE))

project = "dvf_ig"
copyright = "the dvf_ig authors, Apache-2.0"
extensions = ["myst_parser", "autoapi.extension", "docstrings", "formulas", "module_links", "navigation"]

myst_enable_extensions = ["dollarmath", "deflist"]
myst_heading_anchors = 3
myst_dmath_double_inline = True
html_math_renderer = "svg"

autoapi_dirs = [str(ROOT / "dvf_ig"), str(ROOT / "data_synth")]
# commands are described in the guide and by their own --help
autoapi_ignore = ["*/cli/*"]
autoapi_root = "api"
# fields of values are described in their docstrings
autoapi_options = ["members", "show-module-summary"]
autoapi_member_order = "bysource"
autoapi_add_toctree_entry = False
autoapi_python_class_content = "class"
# types are linked where their name is unique
suppress_warnings = ["autoapi.python_import_resolution", "ref.python"]

highlight_language = "none"
html_theme = "furo"
html_title = "dvf_ig"
html_static_path = [str(HERE / "static")]
html_css_files = ["site.css"]
html_show_sphinx = False
html_copy_source = False
html_theme_options = {"navigation_with_keys": True}
