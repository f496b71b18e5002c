"""Concrete as a yield stress fluid with a slip layer, solved by implicit moving particles (MPS) or on a grid.

The modules at this level compute flows in pipes. Modules here import `core`, `geometry`, `theory`, `mix`,
`kernels.common`, `kernels.mps`, `mps.common` and `mps.grid`, but nothing of `dem`. Start with `stages`, which contains
one time step of a flow of particles alone, or with `grid.flow` for flows on a grid.
"""
