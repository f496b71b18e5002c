"""Concrete as a yield stress fluid with a slip layer, solved by implicit moving particles (MPS) or on a grid.

The modules in this folder compute flows in pipes. They import `core`, `geometry`, `theory`, `mix`, `kernels.common`,
`kernels.mps`, `mps.common` and `mps.grid`, but nothing of `dem`. To read the code, start with `stages`, the time step
of a flow that is computed with particles only, or with `grid.flow`, the flow on a grid.
"""
