"""Formulas as MathML, which browsers draw without a script, so that the site works without a network."""

from latex2mathml.converter import convert


def visit_inline(writer, node):
    """Write a formula within a line."""
    writer.body.append(convert(node.astext()))


def visit_block(writer, node):
    """Write a formula on a line of its own."""
    writer.body.append(f'<div class="formula">{convert(node.astext(), display="block")}</div>')


def leave(writer, node):
    """Do nothing: the visit has written the whole formula."""


def setup(app):
    """Register the renderer under the name `mathml`."""
    app.add_html_math_renderer("mathml", (visit_inline, leave), (visit_block, leave))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
