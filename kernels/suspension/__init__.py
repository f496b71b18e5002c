"""Kernels for rigid aggregates in mortar that flows on a grid: aggregates on the grid, viscosity, and coupled solve.

The kernels use the grid functions of `kernels/mps/grid`, but nothing from `kernels/dem`. Start with `bodies`.
"""
