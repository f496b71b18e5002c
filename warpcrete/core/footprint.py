"""What objects hold of a device's memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import warp as wp


def arrays_of(name: str, root: Any) -> Iterator[tuple[str, wp.array]]:
    """Every array that an object of this package, or what it consists of, has the memory of: (path, array)."""
    seen: set[int] = set()
    waiting = [(name, root)]
    while waiting:
        path, value = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, wp.array):
            whole = getattr(value, "_ref", None)
            if whole is not None:  # a view
                waiting.append((path, whole))
            elif value.ptr and getattr(value, "deleter", None) is not None:
                yield path, value
        elif isinstance(value, wp.Mesh):  # its tree is Warp's own
            waiting += [(path, value.points), (path, value.indices)]
        elif isinstance(value, Mapping):
            waiting += [(f"{path}.{key}", each) for key, each in value.items()]
        elif isinstance(value, list | tuple | set):
            waiting += [(path, each) for each in value]
        elif hasattr(type(value), "numpy_dtype") and hasattr(value, "_cls"):  # Warp names no class of its structs
            waiting += [(f"{path}.{key}", getattr(value, key)) for key in value._cls.vars]
        elif type(value).__module__.partition(".")[0] == __name__.partition(".")[0]:
            waiting += [(f"{path}.{key}", each) for key, each in getattr(value, "__dict__", {}).items()]


def footprint(**roots: Any) -> dict[str, int]:
    """Bytes of device memory that each of some objects holds; what two hold counts for the first."""
    sizes: dict[str, int] = dict.fromkeys(roots, 0)
    counted: set[int] = set()
    for name, root in roots.items():
        for _, array in arrays_of(name, root):
            if array.ptr not in counted:
                counted.add(array.ptr)
                sizes[name] += int(array.capacity)
    return sizes
