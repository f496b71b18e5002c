"""Kernels for rigid aggregates in mortar that flows on a grid: forces, viscosity, and the joint solve for velocities.

The kernels use the grid functions of `kernels/mps/grid`, but nothing from `kernels/dem`. Start with `bodies`.
"""
