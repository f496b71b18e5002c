"""Aggregates suspended in mortar: rigid bodies whose motion is solved together with the flow of the mortar on a grid.

The modules in this folder import `core`, `geometry`, `theory`, `mps`, `dem`, `kernels.common`, `kernels.mps` and
`kernels.suspension`; `mps` and `dem` do not import this package. To read the code, start with `flow`, which contains
one time step, and go on with `solve`, which solves its equations.
"""
