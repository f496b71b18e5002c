"""Words with which no docstring or comment of the project begins."""

import io
import re
import tokenize
from pathlib import Path

ROOT = Path(__file__).parents[2]
FOLDERS = ("kernels", "notebooks", "scenes", "tests", "warpcrete")
OPENERS = re.compile(r"(As|What|Of|And|So|By|To|From|Those|Whether) ")
"""Words that begin a fragment of a sentence. A reader who meets such a fragment alone does not know what it means."""


def fragments(source: str) -> list[tuple[int, str]]:
    """Return the lines and the texts of docstrings and blocks of comments that begin with one of `OPENERS`."""
    found = []
    before = tokenize.NEWLINE
    comment_line = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        text = ""
        if token.type == tokenize.STRING and before in (tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT):
            text = token.string.lstrip("rRbBfFuU").strip("\"'").lstrip()
        if token.type == tokenize.COMMENT:
            alone = not token.line[: token.start[1]].strip()
            if not (alone and comment_line == token.start[0] - 1):
                text = token.string.lstrip("# ")
            comment_line = token.start[0] if alone else 0
        if OPENERS.match(text):
            found.append((token.start[0], text.splitlines()[0]))
        if token.type not in (tokenize.COMMENT, tokenize.NL):
            before = token.type
    return found


def test_fragments_are_found():
    source = (
        '"""Of a module."""\n\n# What it is.\n# So this line continues a comment.\nx = "To be"\n\n\n'
        'def f():\n    """As said."""\n'
    )
    assert [line for line, _ in fragments(source)] == [1, 3, 9]


def test_docstrings_and_comments_are_no_fragments():
    found = {}
    for folder in FOLDERS:
        for path in sorted((ROOT / folder).rglob("*.py")):
            if lines := fragments(path.read_text(encoding="utf-8")):
                found[path.relative_to(ROOT).as_posix()] = lines
    assert found == {}
