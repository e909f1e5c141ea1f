"""How the site is built: ``tox -e docs``, or ``sphinx-build -W docs site``.

The gallery runs the scripts of ``examples/``, those that take long in the short form that their
argument ``--short`` asks for. ``-D plot_gallery=0`` builds the pages without running them, and
``sphinx-build -b linkcheck -D plot_gallery=0 docs site`` checks the links to other sites. The
pages load nothing from a network, neither when they are built nor when they are read.
"""

import sys
from pathlib import Path

import pyvista
from numpydoc.xref import DEFAULT_LINKS

import skfem_joint

sys.path.insert(0, str(Path(__file__).parent / "_extensions"))
pyvista.OFF_SCREEN = pyvista.BUILDING_GALLERY = True

project = "skfem_joint"
author = "the skfem_joint developers"
copyright = f"2026, {author}"
version = release = skfem_joint.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.bibtex",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
    "commands",
    "outputs",
    "signatures",
    "offline",
]
# Files of the folders inside examples/ check the package and have no page: their names may repeat.
suppress_warnings = ["sphinx_gallery.duplicate_filename"]
exclude_patterns = [
    "paper.md",
    "verification/measured/*",
    "_extensions",
    "**/sg_execution_times.rst",
]

# Text and mathematics
myst_enable_extensions = ["amsmath", "colon_fence", "deflist", "dollarmath", "fieldlist"]
myst_heading_anchors = 3
smartquotes = False  # quotes are part of values
bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "unsrt"
# Prompts and output are left out where a block is copied.
copybutton_prompt_text = r">>> |\.\.\. |\$ "
copybutton_prompt_is_regexp = True

# Reference of the names in Python: single backticks in docstrings are names.
default_role = "py:obj"
add_module_names = False
autodoc_typehints = "none"  # docstrings say types, shapes and units
autodoc_member_order = "bysource"
autosummary_generate = False
numpydoc_show_class_members = False
numpydoc_xref_param_type = True
# Types in docstrings link to their classes in this reference; those of Python and NumPy, whose own
# references are on the network, stay words.
numpydoc_xref_ignore = "all"
numpydoc_xref_aliases = {
    **{word: word for word in DEFAULT_LINKS},
    **{name: f"skfem_joint.{name}" for name in skfem_joint.__all__ if name[0].isupper()},
    "Basis": "skfem_joint.reduction.basis.Basis",
    "Description": "skfem_joint.study.description.Description",
    "Estimate": "skfem_joint.accuracy.estimate.Estimate",
    "Failure": "skfem_joint.study.results.Failure",
    "JointError": "skfem_joint.ground.errors.JointError",
    "MatrixModel": "skfem_joint.structure.matrices.MatrixModel",
    "SlipHistory": "skfem_joint.reduction.basis.SlipHistory",
}

# Pages
html_theme = "furo"
html_title = "skfem_joint"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_copy_source = html_show_sourcelink = html_show_sphinx = False

# Links to other sites, in a step of its own
linkcheck_timeout = 15
linkcheck_retries = 1
linkcheck_rate_limit_timeout = 30
linkcheck_allowed_redirects = {r"https?://.*": r"https?://.*"}
linkcheck_anchors = False
# This project's own addresses exist once it is published.
linkcheck_ignore = [
    r"https://github\.com/skfem-joint/skfem-joint",
    r"https://skfem-joint\.github\.io/skfem-joint",
]

# The gallery, in the order of docs/_extensions/gallery_settings.py
sphinx_gallery_conf = {
    "examples_dirs": "../examples",
    "gallery_dirs": "gallery",
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"__init__|make_pictures|paraview_joint",
    "within_subsection_order": "gallery_settings.order",
    "minigallery_sort_order": "gallery_settings.order",
    "reset_argv": "gallery_settings.short_form",
    "image_scrapers": ("gallery_settings.pictures", "pyvista"),
    "reset_modules": ("matplotlib", "gallery_settings.without_plotters"),
    "backreferences_dir": "gallery/backreferences",
    "notebook_extensions": set(),
    "download_all_examples": False,
    "remove_config_comments": True,
    "show_memory": False,
    "show_signature": False,
    "write_computation_times": False,
    "doc_module": ("skfem_joint",),
}
