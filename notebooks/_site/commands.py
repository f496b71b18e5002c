"""Commands and output in pages: the style sheet keeps options such as `--out` in one piece at the end of a line."""

from typing import ClassVar

from pygments.lexer import RegexLexer
from pygments.token import Name, Text


class CommandLexer(RegexLexer):
    """Lexer of the language `text` that marks the options of a command."""

    name = "text"
    tokens: ClassVar = {"root": [(r"(?<!\S)--?[a-z][\w-]*", Name.Attribute), (r"\s+|\S+", Text)]}
