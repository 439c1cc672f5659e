"""Settings of the documentation site; `make docs` builds it to docs/_build/html."""

import sys
from pathlib import Path

import fringedic

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "extensions"))

project = "fringedic"
author = "fringedic maintainers"
copyright = author
version = release = fringedic.__version__

extensions = ["sphinx.ext.autodoc", "numpydoc", "myst_nb", "mathml"]
exclude_patterns = ["_build", "extensions", "conf.py", "**.ipynb_checkpoints"]
suppress_warnings = ["mystnb.unknown_mime_type"]

# Markdown
myst_enable_extensions = ["dollarmath", "amsmath", "deflist", "colon_fence"]
myst_heading_anchors = 4
myst_dmath_double_inline = True

# Notebooks are kept without outputs and executed by the build.
nb_execution_mode = "force"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True

# Docstrings: types stand in the numpydoc sections, so signatures show names and defaults alone.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False
numpydoc_xref_param_type = False
python_use_unqualified_type_names = True
add_module_names = False
nitpicky = True

# Page
html_theme = "furo"
html_title = f"fringedic {release}"
html_math_renderer = "mathml"
html_show_copyright = False
html_theme_options = {"navigation_with_keys": True}
highlight_language = "text"
