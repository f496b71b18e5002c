"""Concrete as a yield stress fluid with a slip layer, solved by implicit moving particles (MPS) or on a grid.

All modules of `mps` may import `core`, `geometry`, `theory`, `mix`, `standards`, `kernels.common` and `kernels.mps`,
but nothing of `dem`. The modules in this folder compute flows in pipes, and also import `mps.common` and `mps.grid`. To
read the code, start with `stages`, the time step of a flow that is computed with particles only, or with `grid.flow`,
the flow on a grid.
"""
