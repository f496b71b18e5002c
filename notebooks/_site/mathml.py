"""Formulas as MathML, which browsers draw without a script, so that the site works without a network."""

from docutils import nodes
from latex2mathml.converter import convert


def write_inline(writer, node):
    """Write a formula within a line, instead of its source."""
    writer.body.append(convert(node.astext()))
    raise nodes.SkipNode


def write_block(writer, node):
    """Write a formula on a line of its own, instead of its source."""
    writer.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')
    raise nodes.SkipNode


def setup(app):
    """Register the renderer under the name `mathml`."""
    app.add_html_math_renderer("mathml", (write_inline, None), (write_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
