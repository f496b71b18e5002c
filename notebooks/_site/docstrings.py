"""Preparation of docstrings for reStructuredText.

Docstrings are plain sentences: they contain formulas such as `tau_0 |v|` and names that end in an underscore, which
reStructuredText would take for markup. Literal text, roles and indented blocks stay as they are.
"""

import re

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
