"""Link `kernels` and `scenes` into `warpcrete/`, for type checkers and editors: `python tests/link_folders.py`.

A running program finds both folders beside the package, because `warpcrete/__init__.py` looks there. Type checkers and
editors do not run the program, and look for subpackages in the package's own folder only. Git ignores the links, and
wheels and sdists do not contain them. On Windows the links are junctions, which need no special permission.
"""

import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("kernels", "scenes")


def link_folders(root: Path = ROOT) -> None:
    """Create the links in the checkout `root`, unless they exist already."""
    for name in FOLDERS:
        link = root / "warpcrete" / name
        if link.is_dir():
            continue
        if sys.platform == "win32":
            import _winapi

            _winapi.CreateJunction(str(root / name), str(link))
        else:
            link.symlink_to(Path("..") / name, target_is_directory=True)


if __name__ == "__main__":
    link_folders()
