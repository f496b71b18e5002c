"""Print the graph of imports between the packages of the program: its packages, levels, arrows and cycles.

    python tests/import_graph.py             every folder is a package
    python tests/import_graph.py --whole     subpackages count as parts of their package
    python tests/import_graph.py OTHER       the same for another checkout of the repository

The level of a package is 1 if it imports no other package; otherwise it is one more than the highest level of an
imported package. Packages that import each other in a cycle have the same level.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "house"))

import test_house as house


def folder(module: str, whole: bool) -> str:
    """Return the package of a module: its folder, or the package of the house rules if `whole` is true."""
    if whole and module != "__main__":
        return house.package_of(module)
    is_package = house.MODULES[module].name == "__init__.py" or module == "methods"
    return module if is_package else module.rpartition(".")[0]


def package_graph(whole: bool) -> dict[str, set[str]]:
    """Return the imported packages of each package, without the packages `warpcrete` and `kernels` themselves."""
    graph: dict[str, set[str]] = {}
    for module in house.MODULES:
        own = folder(module, whole)
        # A package's __init__ that gathers the names of its own modules does not make them depend on each other.
        targets = {target for target in house.imports(module) if not module.startswith(f"{target}.") or whole}
        graph.setdefault(own, set()).update(folder(target, whole) for target in targets if target)
    for name in ("", "kernels"):
        graph.pop(name, None)
    return {own: targets & graph.keys() - {own} for own, targets in graph.items()}


def reachable(graph: dict[str, set[str]], package: str) -> set[str]:
    """Return all packages that a package imports, directly or through other packages."""
    found, waiting = set(), [package]
    while waiting:
        new = graph[waiting.pop()] - found
        found |= new
        waiting += new
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkout", nargs="?", type=Path, help="root folder of another checkout")
    parser.add_argument("--whole", action="store_true", help="count subpackages as parts of their package")
    options = parser.parse_args()
    if options.checkout is not None:
        house.ROOT = options.checkout.resolve()
        house.MODULES = house.modules()
    graph = package_graph(options.whole)
    below = {package: reachable(graph, package) for package in graph}
    # The packages of a cycle reach each other, so they are levelled together.
    groups = {
        frozenset({package, *(other for other in below[package] if package in below[other])}) for package in graph
    }
    group_of = {package: group for group in groups for package in group}
    levels: dict[frozenset[str], int] = {}
    for group in sorted(groups, key=lambda group: len(set().union(*(below[package] for package in group)) - group)):
        imported = {group_of[target] for package in group for target in graph[package]} - {group}
        levels[group] = 1 + max((levels[other] for other in imported), default=0)
    for group in sorted(groups, key=lambda group: (levels[group], sorted(group))):
        for package in sorted(group):
            print(f"{levels[group]:2d}  {package:22s} {', '.join(sorted(graph[package]))}")
    cycles = [sorted(group) for group in groups if len(group) > 1]
    arrows = sum(map(len, graph.values()))
    print(f"{len(graph)} packages, {max(levels.values())} levels, {arrows} arrows, {len(cycles)} cycles", *cycles)


if __name__ == "__main__":
    main()
