"""Configuration of the documentation site. Build it with `sphinx-build -W notebooks build/site`."""

import sys
from pathlib import Path

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_site"))

import generated  # noqa: E402
from commands import CommandLexer  # noqa: E402
from docstrings import escape, resolve  # noqa: E402

import warpcrete  # noqa: E402

project = "warpcrete"
author = "the authors of warpcrete"
copyright = author
version = release = warpcrete.__version__

extensions = [
    "myst_nb",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx_copybutton",
    "sphinx_design",
    "sphinxcontrib.mermaid",
    "mathml",
]
exclude_patterns = ["_site", "**/.ipynb_checkpoints", "targets"]
nb_execution_mode = "off"  # The notebooks' outputs are stored with them; a test compares them with fresh ones.
nb_render_markdown_format = "myst"  # The default, CommonMark, shows tables in the notebooks' outputs as plain text.
suppress_warnings = ["mystnb.unknown_mime_type", "ref.python"]

myst_enable_extensions = ["colon_fence", "dollarmath", "amsmath", "deflist", "attrs_inline"]
myst_fence_as_directive = ["mermaid"]
myst_heading_anchors = 3

add_module_names = False
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autosummary_generate = True
autosummary_ignore_module_all = False
default_role = "code"
highlight_language = "text"
smartquotes = False  # Two hyphens begin an option.
nitpicky = True
# Types in signatures come from other packages and from type variables, of which this site has no pages. Nor has it
# pages of private functions, which docstrings of one module may name. All other references are checked.
nitpick_ignore_regex = [
    (r"py:(class|obj|attr|data|exc)", r"(?!warpcrete\.).*"),
    (r"py:(class|obj)", r"warpcrete\..*\.([A-Z]|_\w+|[a-z_]+|Found|GridKind|Annotated.*)"),
    (r"py:.*", r"warpcrete\.kernels\..*"),
    (r"py:func", r"_\w+"),
]

templates_path = ["_site/templates"]
html_math_renderer = "mathml"
html_theme = "pydata_sphinx_theme"
html_title = "warpcrete"
html_static_path = ["_site/static"]
html_css_files = ["site.css"]
html_show_sourcelink = False
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "header_links_before_dropdown": 7,
    "navbar_persistent": ["search-button"],
    "collapse_navigation": True,
    "navigation_depth": 3,
    "secondary_sidebar_items": ["page-toc"],
    "footer_start": ["copyright"],
    "footer_end": ["sphinx-version"],
}
html_sidebars = {"index": [], "gallery/index": []}
copybutton_prompt_text = r">>> |\$ "
copybutton_prompt_is_regexp = True


def setup(app):
    """Write the generated pages before Sphinx looks for sources, and prepare docstrings for reStructuredText."""
    generated.write(HERE / "reference" / "generated")
    app.add_lexer("text", CommandLexer)
    app.connect("autodoc-process-docstring", escape)
    app.connect("missing-reference", resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
