"""Kernels for rigid aggregates in a grid flow of mortar: places on the grid, viscosity beside them, coupled solve.

They use the grid functions of `kernels/mps/grid` and nothing of `kernels/dem`. Start with `bodies`.
"""
