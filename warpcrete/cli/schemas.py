"""JSON schemas of the files that users write. Editors use the schemas to complete and check such files.

`tests/studies/schema_builder.py` derives the schemas from the declarations that also check these files.
"""

from pathlib import Path

from ..core.errors import refuse, suggested

FOLDER = Path(__file__).parents[1] / "schemas"
"""Folder of the schemas, one JSON file for each kind of file."""


def shipped_schema(kind: str) -> Path:
    """Return the path of the package's schema for a kind of file; raise :class:`SceneError` for an unknown kind."""
    known = sorted(path.stem for path in FOLDER.glob("*.json"))
    if kind not in known:
        refuse("schema", kind, f"must be one of {', '.join(known)}", suggested(kind, known))
    return FOLDER / f"{kind}.json"
