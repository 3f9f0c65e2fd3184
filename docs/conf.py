"""Builds the site: these pages, the examples with their pictures, and the references. `./run docs` calls it."""

import os
import sys
import warnings
from pathlib import Path

import matplotlib

import spharm_rs

HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE / "_extensions"), str(HERE / "figures"), str(HERE.parent / "examples" / "python")]

from standalone_notebooks import first_cell  # noqa: E402

# The programs that pages and examples start find the modules, too.
os.environ["PYTHONPATH"] = str(HERE.parent / "examples" / "python")
matplotlib.use("agg")
warnings.filterwarnings("ignore", message=".*non-interactive.*")

project = "spharm-rs"
author = "The spharm-rs developers"
copyright = author
version = release = spharm_rs.__version__

extensions = [
    "matplotlib.sphinxext.plot_directive",
    "myst_parser",
    "numpydoc",
    "program",
    "repository",
    "short_names",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx_design",
    "sphinx_gallery.gen_gallery",
    "sphinx-mathjax-offline",
    "standalone_notebooks",
]
exclude_patterns = ["figures", "_extensions", "_templates", "requirements.txt"]
templates_path = ["_templates"]
default_role = "py:obj"
highlight_language = "text"
nitpicky = True
# Private aliases of types, in annotations.
nitpick_ignore_regex = [("py:class", r"spharm_rs\._.*")]
# Bases of classes; the inventories of other sites would be fetched.
nitpick_ignore = [("py:class", f"sklearn.base.{name}") for name in ("BaseEstimator", "TransformerMixin")]

html_theme = "pydata_sphinx_theme"
html_title = f"spharm-rs {release}"
html_theme_options = {
    "show_nav_level": 1,
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "footer_start": ["copyright"],
    "footer_end": [],
    # Icons of other sites would be fetched.
    "icon_links": [],
}
# Pages without pages below them have nothing to show there.
html_sidebars = {pattern: [] for pattern in ("*", "start/*", "contributing/*")}
html_copy_source = False
html_show_sourcelink = False

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3

autosummary_generate = True
autodoc_typehints = "none"
autodoc_member_order = "bysource"
numpydoc_show_class_members = False

plot_formats = [("png", 140)]
plot_html_show_formats = False
plot_html_show_source_link = False
plot_include_source = False

sphinx_gallery_conf = {
    "examples_dirs": "../examples/python",
    "gallery_dirs": "gallery",
    "filename_pattern": r"[/\\]\d_",
    "ignore_pattern": r"draw\.py",
    "within_subsection_order": "FileNameSortKey",
    "abort_on_example_error": True,
    "default_thumb_file": str(HERE / "picture.png"),
    "download_all_examples": False,
    "first_notebook_cell": first_cell(),
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "image_scrapers": ("matplotlib",),
    "matplotlib_animations": False,
    "plot_gallery": True,
}
