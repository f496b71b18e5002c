"""Preparation of docstrings for reStructuredText.

Docstrings are plain sentences: they contain formulas such as `tau_0 |v|` and names that end in an underscore, which
reStructuredText would take for markup. Literal text, roles and indented blocks stay as they are.
"""

import re

from sphinx.util.nodes import make_refnode

KEPT = re.compile(r"(``.+?``|:[\w:]+:`[^`]+`|`[^`]+`)")
"""Parts of a line that are markup on purpose: literal text, roles and code."""
SPECIAL = re.compile(r"[*|]|(?<=\w)_(?!\w)|\\")


def escape(app, what, name, kind, options, lines):
    """Escape characters with a meaning in reStructuredText, in place; a handler of `autodoc-process-docstring`."""
    literal = False
    for number, line in enumerate(lines):
        if literal and line.strip() and not line.startswith((" ", "\t")):
            literal = False
        if not literal and not line.lstrip().startswith(("..", ":param", ":type", ":return", ":rtype", ":raises")):
            parts = KEPT.split(line)
            parts[::2] = [SPECIAL.sub(lambda found: "\\" + found.group(), part) for part in parts[::2]]
            lines[number] = "".join(parts)
        literal = literal or line.rstrip().endswith("::")


def resolve(app, env, node, content):
    """Resolve a name of the package that is written in another way; a handler of `missing-reference`.

    A class that `warpcrete` exports is documented under its short name. Another name may stand without its module, if
    an object of the package has it; the first such object is taken.
    """
    if node.get("refdomain") != "py":
        return None
    objects = env.get_domain("py").objects
    target = node["reftarget"].lstrip(".~")
    short = "warpcrete." + target.rpartition(".")[2]
    found = [short] if short in objects else [name for name in objects if name.endswith("." + target)]
    if not found:
        return None
    entry = objects[min(found)]
    return make_refnode(app.builder, node["refdoc"], entry.docname, entry.node_id, content)
