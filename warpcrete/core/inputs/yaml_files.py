# The package ruamel.yaml declares hardly any types, so Pyright must not report unknown types in this file.
# pyright: reportUnknownMemberType=false, reportUnknownVariableType=false, reportUnknownArgumentType=false
"""Reader and writer of YAML 1.2 files: the core schema without tags, with the line number of every entry."""

import io
import re
import warnings
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import MarkedYAMLError
from ruamel.yaml.nodes import ScalarNode
from ruamel.yaml.representer import SafeRepresenter
from ruamel.yaml.resolver import VersionedResolver
from ruamel.yaml.scanner import Scanner
from ruamel.yaml.tag import Tag

from ..errors import one_line

MAXIMUM_VALUES = 50_000
"""Maximum number of values in a YAML file; a value counts once more for each alias that repeats it."""
MAXIMUM_DEPTH = 100
"""Maximum nesting depth of lists and mappings in a YAML file; deeper nesting is refused."""
LONGEST_NUMBER = 400
"""Maximum number of characters of a number in a YAML file."""
INTEGER_PATTERN = re.compile(r"[-+]?[0-9]+|0o[0-7]+|0x[0-9a-fA-F]+")
DECIMAL_PATTERN = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
NOT_A_NUMBER = re.compile(r"[-+]?\.(inf|Inf|INF)|\.(nan|NaN|NAN)")
TRAILING_BLANKS = re.compile(r"(?<![ \t])[ \t]+(?=\r|$)", re.MULTILINE)
WORDS: dict[str, bool | None] = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE"), True),
    **dict.fromkeys(("false", "False", "FALSE"), False),
}
PLAIN_TAG = "plain"
"""Tag that the parser gives to YAML scalars without quotes and without a tag of their own."""


class FileMapping(dict[str, Any]):
    """Mapping whose entries come from files.

    `lines` holds the line of each key; `path` is the file, unless :func:`merged` made the mapping.
    """

    path: Path
    lines: dict[str, int]
    files: Mapping[str, Path] = MappingProxyType({})
    """Files of the entries of a mapping that :func:`merged` made from several files."""


def merged(*mappings: Mapping[str, object]) -> FileMapping:
    """Return the entries of all `mappings`, of which later ones take precedence, with the file and line of each entry.

    Entries of a mapping that was not read from a file have neither.
    """
    union, lines, files = FileMapping(), dict[str, int](), dict[str, Path]()
    for mapping in mappings:
        for key, value in mapping.items():
            union[key] = value
            lines.pop(key, None)
            files.pop(key, None)
            if isinstance(mapping, FileMapping):
                lines |= {key: mapping.lines[key]} if key in mapping.lines else {}
                path = mapping.files.get(key, getattr(mapping, "path", None))
                files |= {} if path is None else {key: path}
    union.lines, union.files = lines, files
    return union


class FileList(list[Any]):
    """List from a YAML file, with the `path` of the file and the line number of each entry in `lines`."""

    path: Path
    lines: list[int]


class Unreadable(Exception):
    """Error: a file cannot be read. The attributes are the reason, with the line number if known, and a hint."""

    def __init__(self, reason: str, hint: str = "", line: int | None = None) -> None:
        super().__init__(reason)
        self.reason = one_line(reason if line is None else f"line {line}: {reason}")
        self.hint = hint


class UntaggedResolver(VersionedResolver):
    """YAML resolver that gives scalars without quotes and tags the tag `PLAIN_TAG`, in all versions of YAML.

    The parser therefore does not interpret them, and this module determines their types.
    """

    def resolve(self, kind: Any, value: object, implicit: Any) -> Any:
        """Return the YAML tag, which states the type, for a node that has no tag in the file."""
        if kind is ScalarNode and implicit[0]:
            return Tag(suffix=PLAIN_TAG)
        return super().resolve(kind, value, implicit)


class DepthLimitedScanner(Scanner):
    """YAML scanner that refuses deep nesting, because scanning time grows with the square of the nesting depth."""

    def fetch_flow_collection_start(self, *arguments: object, **named: object) -> None:
        """Scan the opening bracket of a list or mapping; raises :class:`Unreadable` if it is nested too deeply."""
        if len(self.flow_context) >= MAXIMUM_DEPTH:
            raise Unreadable("is nested too deeply", "use fewer lists and mappings inside each other")
        super().fetch_flow_collection_start(*arguments, **named)


def parsed_yaml(text: str, path: Path) -> object:
    """Return the value of a YAML text: mappings, lists, texts, finite numbers, true, false or None.

    Keys are always texts. Mappings and lists store `path`, the path of the file. Raises :class:`Unreadable` for any
    other content.
    """
    parser = YAML(typ="safe", pure=True)
    parser.Resolver, parser.Scanner = UntaggedResolver, DepthLimitedScanner
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Ignore warnings about YAML anchors that are defined twice.
            node = parser.compose(_without_trailing_tabs(text))
        return None if node is None else _Values(path).value(node)
    except Unreadable:
        raise
    except RecursionError as error:
        raise Unreadable("is nested too deeply", "use fewer lists and mappings inside each other") from error
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        reason = " ".join(f"is not valid YAML: {error.problem or error.context or 'it cannot be read'}".split())
        line = None if mark is None else mark.line + 1
        lines = "write spaces instead of tabs" if "'\\t'" in reason else "write 'key: value' lines"
        if reason.endswith("found '-'"):
            lines = "indent all dashes of a list equally"
        quotes = ", and put quotes around a value with #, which otherwise starts a comment" if "#" in text else ""
        raise Unreadable(reason, f"{lines}{quotes}", line) from error
    except Exception as error:  # Parts of the YAML parser may raise any exception.
        reason = " ".join(str(error).split()) or type(error).__name__
        raise Unreadable(f"is not valid YAML: {reason}", "write 'key: value' lines") from error


def _without_trailing_tabs(text: str) -> str:
    """Remove blanks from the ends of lines if the text has tabs; YAML allows tabs there, but the parser does not.

    Values of several lines also lose these blanks, which have no meaning for this program.
    """
    return TRAILING_BLANKS.sub("", text) if "\t" in text else text


class _Values:
    """Converter of the nodes of one YAML file into Python values."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.values = 0
        self.open: set[int] = set()
        """Values of `id()` of the YAML nodes whose contents are being read. If the reader meets one of these nodes, the
        node contains itself."""

    def value(self, node: Any) -> Any:
        line = node.start_mark.line + 1
        self.values += 1
        if self.values > MAXIMUM_VALUES:
            raise Unreadable(f"contains more than {MAXIMUM_VALUES:,} values", "check that it is the right file")
        if isinstance(node.value, str):
            return self._scalar(node, line)
        if not str(node.tag).endswith((":map", ":seq")):
            raise Unreadable(f"has the tag {node.tag}, which is not supported", "remove the tag", line)
        if id(node) in self.open:
            raise Unreadable(
                "has an alias (*name) that refers to itself",
                "replace the alias by the contents that it stands for",
                line,
            )
        self.open.add(id(node))
        try:
            if str(node.tag).endswith(":seq"):
                return self._list(node, line)
            return self._mapping(node, line)
        finally:
            self.open.discard(id(node))

    def _list(self, node: Any, line: int) -> FileList:
        if any(isinstance(each, tuple) for each in node.value):
            raise Unreadable("has the tag !!seq before a mapping", "remove the tag", line)
        found = FileList(self.value(each) for each in node.value)
        found.path, found.lines = self.path, [each.start_mark.line + 1 for each in node.value]
        return found

    def _mapping(self, node: Any, line: int) -> FileMapping:
        if any(not isinstance(each, tuple) for each in node.value):
            raise Unreadable("has the tag !!map before a list", "remove the tag", line)
        found = FileMapping()
        found.path, found.lines = self.path, {}
        for key, value in node.value:
            line = key.start_mark.line + 1
            if not isinstance(key.value, str) or not str(key.tag).endswith((PLAIN_TAG, ":str")):
                raise Unreadable("has a key that is not text", "write text before the colon, as in 'key: value'", line)
            if key.value in found:
                raise Unreadable(f"has the key {one_line(key.value, 100)!r} twice, first in line "
                                  f"{found.lines[key.value]}", "remove one of the two", line)  # fmt: skip
            found[key.value] = self.value(value)
            found.lines[key.value] = line
        return found

    def _scalar(self, node: Any, line: int) -> Any:
        text = node.value
        if str(node.tag).endswith(":str"):
            return text
        if node.tag != PLAIN_TAG:
            tag = str(node.tag).replace("tag:yaml.org,2002:", "!!")
            raise Unreadable(f"has the tag {tag} before {one_line(text, 60)!r}", "remove the tag", line)
        if text in WORDS:
            return WORDS[text]
        if NOT_A_NUMBER.fullmatch(text):
            raise Unreadable(f"has {text}, which is not a finite number", "write a finite number", line)
        if not text[:1].isdigit() and text[:1] not in ("+", "-", "."):
            return text
        if not (DECIMAL_PATTERN.fullmatch(text) or INTEGER_PATTERN.fullmatch(text)):
            return text
        if len(text) > LONGEST_NUMBER:
            raise Unreadable(
                f"has a number of {len(text)} digits", "write the number with an exponent, as in 1e30", line
            )
        if INTEGER_PATTERN.fullmatch(text):
            return int(text, {"0o": 8, "0x": 16}.get(text[:2], 10))
        value = float(text)
        if value in (float("inf"), float("-inf")):
            raise Unreadable(f"has {text}, which is too large for a number", "write a number below 1e308", line)
        return value


class NumberRepresenter(SafeRepresenter):
    """YAML representer that also writes instances of subclasses of `float`, such as numbers that remember a text."""


NumberRepresenter.add_multi_representer(float, SafeRepresenter.represent_float)


def yaml_text(data: Mapping[str, object]) -> str:
    """Return a mapping as YAML text, with its keys in their order."""
    writer = YAML(typ="safe", pure=True)
    writer.Representer = NumberRepresenter
    writer.default_flow_style = False
    writer.allow_unicode = True
    writer.sort_base_mapping_type_on_output = False  # type: ignore[assignment]
    out = io.StringIO()
    writer.dump(data, out)
    return out.getvalue()
