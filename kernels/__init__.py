"""Warp kernels of warpcrete: device code only, built by factory functions that take the scalar type.

A factory such as ``dem.contacts.contact_kernel(scalar, ...)`` returns a kernel that is specialised for one precision
and one set of features. Factories are cached, so a second call with the same arguments compiles nothing.

Modules here import Warp, NumPy and each other. The folders `dem` and `mps` use `common` but not each other;
`suspension` uses `common` and `mps`, and `common` uses no other folder. Start with `common.types`, and go on with
`dem.structs` or `mps.structs`, which describe all arrays.
"""

if __name__ != "warpcrete.kernels":
    raise ImportError(f"the kernel package was imported as {__name__!r}; import it as 'warpcrete.kernels'")
