"""How Sphinx builds the site: `make docs`."""

import radiosity

project = "radiosity"
author = "the radiosity developers"
version = release = radiosity.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = "radiosity"
exclude_patterns = ["README.md"]
# Every notebook and every page with cells is run, and an error in one fails the build.
nb_execution_mode = "force"
nb_execution_timeout = 300
nb_execution_raise_on_error = True
nb_merge_streams = True
autodoc_member_order = "bysource"
autodoc_typehints = "none"
