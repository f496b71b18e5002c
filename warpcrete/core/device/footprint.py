"""Functions that find the Warp arrays in objects of this package and add up their device memory."""

from collections.abc import Iterator
from operator import attrgetter

import warp as wp

from ..narrowing import is_list_or_tuple, is_mapping, is_set
from .arrays import DeviceArray, is_struct


def arrays_of(name: str, root: object) -> Iterator[tuple[str, DeviceArray]]:
    """Yield (path, array) for each Warp array in `root` that owns its memory; a path is like "NAME.attribute.key".

    The search descends into lists, mappings, meshes, structs and the attributes of objects of this package. Each path
    begins with `name`.
    """
    seen: set[int] = set()
    waiting: list[tuple[str, object]] = [(name, root)]
    while waiting:
        path, value = waiting.pop()
        if id(value) in seen:
            continue
        seen.add(id(value))
        if isinstance(value, DeviceArray):
            whole = getattr(value, "_ref", None)
            if whole is not None:  # The array is a view: continue with the array that owns the memory.
                waiting.append((path, whole))
            elif value.ptr and getattr(value, "deleter", None) is not None:
                yield path, value
        elif isinstance(value, wp.Mesh):  # Warp hides a mesh's search tree, so count only points and indices.
            waiting += [(path, each) for each in attrgetter("points", "indices")(value)]
        elif is_mapping(value):
            waiting += [(f"{path}.{key}", each) for key, each in value.items()]
        elif is_list_or_tuple(value) or is_set(value):
            waiting += [(path, each) for each in value]
        elif is_struct(value) or type(value).__module__.partition(".")[0] == __name__.partition(".")[0]:
            waiting += [(f"{path}.{key}", each) for key, each in getattr(value, "__dict__", {}).items()]


def footprint(**roots: object) -> dict[str, int]:
    """Return the device memory of each object [B], by name.

    An array that several objects use is counted only for the first of these objects.
    """
    sizes: dict[str, int] = dict.fromkeys(roots, 0)
    counted: set[int] = set()
    for name, root in roots.items():
        for _, array in arrays_of(name, root):
            if array.ptr not in counted:
                counted.add(array.ptr)
                sizes[name] += int(array.capacity)
    return sizes
