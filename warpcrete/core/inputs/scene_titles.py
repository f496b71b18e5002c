"""Names and titles of all scenes, read from their files without importing the scenes and Warp."""

import ast
from pathlib import Path


def scene_titles(folder: Path) -> dict[str, str]:
    """Return the title of each scene in a folder of scene files, by the scene's name.

    The title is the first line of the file's docstring. A file NAME.py with a function `scene_dem` also defines the
    scene NAME-dem, which simulates the same test by discrete elements.
    """
    found: dict[str, str] = {}
    for path in folder.glob("[!_]*.py"):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        functions = {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}
        name, title = path.stem.replace("_", "-"), (ast.get_docstring(tree) or "").partition("\n")[0]
        if "scene" in functions:
            found[name] = title
        if "scene_dem" in functions:
            found[f"{name}-dem"] = f"{title.rpartition(', ')[0] or title.rstrip('.')}, by discrete elements."
    return dict(sorted(found.items()))
