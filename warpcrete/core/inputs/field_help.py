"""Help for the fields of data classes, made from the docstrings of the fields."""

import ast
import inspect
import textwrap
from typing import TypeVar

T = TypeVar("T", bound=type)


def help_on_fields(documented: T) -> T:
    """Append the docstring of each field to the docstring of the class `documented`, so that `help` shows all fields.

    Python discards the docstrings of fields when it loads a class, so this decorator reads them from the source code.
    If there is no source code, it leaves the class unchanged. It returns the class.
    """
    try:
        (definition,) = ast.parse(textwrap.dedent(inspect.getsource(documented))).body
    except (OSError, SyntaxError):
        return documented
    assert isinstance(definition, ast.ClassDef)
    lines = ["Fields:", ""]
    for field, text in zip(definition.body, definition.body[1:]):
        if not (isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name)):
            continue
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str):
            meaning = " ".join(text.value.value.split())
            entry = f"- `{field.target.id}`: {meaning}"
            lines += textwrap.wrap(entry, 112, subsequent_indent="  ", break_long_words=False, break_on_hyphens=False)
    documented.__doc__ = "\n".join([inspect.cleandoc(documented.__doc__ or ""), "", *lines])
    return documented
