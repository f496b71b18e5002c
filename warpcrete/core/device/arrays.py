"""Types of Warp's arrays, structs and scalars, and Warp's array functions with these types.

Warp does not declare the types of array elements and of host copies, so a type checker could not check their use. When
the program runs, the names of this module are Warp's own objects. Only type checkers and editors see the declarations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import warp as wp
from numpy.typing import ArrayLike, NDArray

HostArray: TypeAlias = NDArray[Any]
"""NumPy array whose element type is known only at run time, because it depends on a device array or a file."""
Scalar: TypeAlias = type[wp.float32] | type[wp.float64]
"""Floating-point type of kernels, `wp.float32` or `wp.float64`."""
Shape: TypeAlias = int | tuple[int, ...]

if TYPE_CHECKING:

    class DeviceArray(wp.array[Any, int]):
        """Array in the memory of a device, a ``wp.array``."""

        shape: tuple[int, ...]
        ptr: int
        capacity: int
        device: wp.Device

        def __init__(
            self,
            data: ArrayLike | Sequence[object],
            dtype: type | Struct,
            *,
            device: wp.Device | str | None = None,
            ndim: int | None = None,
        ) -> None: ...

        def __len__(self) -> int: ...

        def __iter__(self) -> Iterator[DeviceArray]: ...

        def __getitem__(self, key: slice | int | tuple[slice | int, ...]) -> DeviceArray:
            """Return the elements that `key` selects, as a view that shares the array's memory."""
            ...

        def numpy(self, *, _suppress_bfloat16_warning: bool = False) -> HostArray:
            """Return the values as a NumPy array: a view for an array on a CPU, a copy for an array on a GPU."""
            ...

        def assign(self, src: ArrayLike | DeviceArray) -> None:
            """Copy values from the host or from another array of the same shape."""

        def zero_(self) -> None:
            """Set all values of the array to zero."""

        def fill_(self, value: object) -> None:
            """Set all elements of the array to `value`."""

    def zeros(
        shape: Shape, dtype: type | Struct, *, device: wp.Device | str | None = None, pinned: bool = False
    ) -> DeviceArray:
        """Return a new array filled with zeros; `pinned` selects page-locked memory of the host."""
        ...

    def ones(shape: Shape, dtype: type, *, device: wp.Device | str | None = None) -> DeviceArray:
        """Return a new array filled with ones."""
        ...

    def empty(
        shape: Shape, dtype: type | Struct, *, device: wp.Device | str | None = None, pinned: bool = False
    ) -> DeviceArray:
        """Return a new array without initial values; `pinned` selects page-locked memory of the host."""
        ...

    def clone(src: DeviceArray) -> DeviceArray:
        """Return a copy of the array `src` on the same device."""
        ...

    def copy_array(
        dest: DeviceArray, src: DeviceArray, dest_offset: int = 0, src_offset: int = 0, count: int = 0
    ) -> None:
        """Copy `count` elements of `src` to `dest`, or the whole array if `count` is 0.

        The offsets are the indices of the first element to copy in `src`, and of its copy in `dest`.
        """

    def load_module(module: KernelModule, *, device: wp.Device, block_dim: int) -> None:
        """Compile the kernels of a module for `block_dim` threads per block, or load them from the cache."""

    def full(shape: Shape, value: float, *, dtype: type, device: wp.Device) -> DeviceArray:
        """Return a new array in which every element is `value`."""
        ...

    def launch_kernel(
        kernel: Kernel, *, dim: Shape, inputs: Sequence[object], device: wp.Device, record_cmd: bool = False,
        block_dim: int = 256,
    ) -> wp.Launch | None:  # fmt: skip
        """Launch `dim` threads of a kernel or, if `record_cmd` is true, return an object that launches them later."""

    def capture_if(condition: DeviceArray, on_true: Callable[[], None]) -> None:
        """Add the work that `on_true` launches to a graph, as a conditional node.

        Each time the graph reaches this node, it runs the work if `condition`, shape (1,), is not 0.
        """

    def array_scan(in_array: DeviceArray, out_array: DeviceArray, inclusive: bool) -> None:
        """Write the prefix sums of `in_array` to `out_array`.

        If `inclusive` is true, the sum at an index contains the element at this index.
        """

    def radix_sort_pairs(keys: DeviceArray, values: DeviceArray, count: int, *, end_bit: int) -> None:
        """Sort the first `count` keys and their values by the lowest `end_bit` bits of the keys."""

    def bytes_of(dtype: type) -> int:
        """Return the size of one element of an array [B]."""
        ...

    def is_struct(value: object) -> bool:
        """Return whether a kernel argument is a Warp struct, as opposed to a number or an array."""
        ...

else:
    DeviceArray = wp.array
    zeros, ones, empty, full, clone, copy_array = wp.zeros, wp.ones, wp.empty, wp.full, wp.clone, wp.copy
    launch_kernel, load_module, capture_if = wp.launch, wp.load_module, wp.capture_if
    array_scan, radix_sort_pairs = wp.utils.array_scan, wp.utils.radix_sort_pairs
    bytes_of, is_struct = wp.types.type_size_in_bytes, wp.types.is_struct


class StructMember(Protocol):
    """Member of a Warp struct; `type` is its type annotation."""

    @property
    def type(self) -> Any:
        """Type annotation of the struct member, such as ``wp.array(dtype=...)``."""
        ...


class Struct(Protocol):
    """Struct type that ``wp.struct`` makes from a class. Calling the type returns a struct with empty arrays."""

    @property
    def vars(self) -> Mapping[str, StructMember]:
        """Members of the struct, by name."""
        ...

    def __call__(self) -> Any: ...

    def numpy_dtype(self) -> Any:
        """Return the NumPy element type for host arrays of structs of this type."""
        ...


class KernelArgument(Protocol):
    """Parameter of a kernel; `label` is its name."""

    @property
    def label(self) -> str:
        """Name of a kernel's parameter."""
        ...


class KernelCode(Protocol):
    """Code of a kernel as Warp has parsed it from Python; `args` holds the kernel's parameters."""

    @property
    def args(self) -> Sequence[KernelArgument]:
        """Parameters of the kernel, in order."""
        ...


class KernelFunction(Protocol):
    """Python function from which a kernel was made."""

    @property
    def __name__(self) -> str: ...


class Kernel(Protocol):
    """Kernel, as ``wp.kernel`` returns it."""

    @property
    def key(self) -> str:
        """Name of the kernel."""
        ...

    @property
    def func(self) -> KernelFunction:
        """Python function of the kernel."""
        ...

    @property
    def adj(self) -> KernelCode:
        """Code of the kernel as Warp has parsed it from Python."""
        ...

    @property
    def module(self) -> KernelModule:
        """Module of Warp to which the kernel belongs; the kernels of a module are compiled together."""
        ...


class KernelModule(Protocol):
    """Module of Warp: one or several kernels that are compiled together."""

    @property
    def kernels(self) -> Mapping[str, Kernel]:
        """Kernels of this module, by name."""
        ...

    @property
    def execs(self) -> Mapping[tuple[object, int], LoadedModule]:
        """Compiled code that this process has loaded, by device and block size."""
        ...


class LoadedModule(Protocol):
    """Compiled code of a module on one device, for one block size."""

    @property
    def binary_path(self) -> str | None:
        """Path of the file in Warp's cache from which the code was loaded."""
        ...


def host_copy(array: DeviceArray) -> HostArray:
    """Return the current values of an array as a copy in host memory, which later changes of the array do not affect.

    In contrast, the result of `array.numpy()` shares the memory of an array on a CPU.
    """
    return array.numpy().copy() if array.device.is_cpu else array.numpy()


def declared(struct: Struct) -> Struct:
    """Return `struct` unchanged, so that a type checker regards it as a :class:`Struct`.

    The decorator ``wp.struct`` does not declare the type of its result. An annotation of the variable does not suffice,
    because the type checker would keep the unknown type of the assigned value.
    """
    return struct
