"""How the site is built: ``tox -e docs``, or ``sphinx-build -W docs SITE``.

The gallery runs the scripts of ``examples/`` in their short forms, which the argument ``--short``
asks for. ``-D plot_gallery=0`` builds the pages without running them.
"""

import re
import shutil
from pathlib import Path

from sphinx_gallery.scrapers import figure_rst
from sphinx_gallery.sorting import ExplicitOrder

import skfem_joint

ROOT = Path(__file__).resolve().parents[1]

project = "skfem_joint"
author = "the skfem_joint developers"
copyright = f"2026, {author}"
version = release = skfem_joint.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.intersphinx",
    "numpydoc",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.bibtex",
    "sphinx_copybutton",
    "sphinx-mathjax-offline",
]
exclude_patterns = ["build", "paper.md", "verification/measured/*"]
nitpicky = False

myst_enable_extensions = ["deflist", "dollarmath", "fieldlist", "colon_fence"]
myst_heading_anchors = 3
bibtex_bibfiles = ["references.bib"]
bibtex_default_style = "unsrt"

html_theme = "furo"
html_title = "skfem_joint"
html_static_path = ["_static"]
html_css_files = ["site.css"]
html_show_sourcelink = False

numpydoc_show_class_members = False
autodoc_member_order = "bysource"
# Pages are built without a network; these are other projects' names, which then stay plain text.
intersphinx_mapping = {}


def short_form(configuration, script):
    """Arguments of a gallery script: its short form."""
    return ["--short"]


def written_pictures(block, block_vars, gallery_conf):
    """Pictures that a gallery script has written beside itself: NAME.png, NAME-2.png and so on."""
    script = Path(block_vars["src_file"])
    pictures = []
    for name in (f"{script.stem}.png", f"{script.stem}-?.png"):
        for picture in sorted(script.parent.glob(name)):
            pictures.append(next(block_vars["image_path_iterator"]))
            shutil.move(picture, pictures[-1])
    return figure_rst(pictures, gallery_conf["src_dir"])


#: Scripts in the order of the gallery's first page.
ORDER = re.findall(
    r"examples/(\w+\.py)", (ROOT / "examples" / "GALLERY_HEADER.rst").read_text(encoding="utf-8")
)

sphinx_gallery_conf = {
    "examples_dirs": [str(ROOT / "examples")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"__init__|paraview_joint",
    "reset_argv": short_form,
    "image_scrapers": (written_pictures,),
    "within_subsection_order": ExplicitOrder([*ORDER, "*"]),
    "backreferences_dir": "gallery/backreferences",
    "show_memory": False,
    "download_all_examples": False,
}
