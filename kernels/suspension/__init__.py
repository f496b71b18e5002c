"""Kernels for rigid aggregates in mortar that flows on a grid: forces, viscosity, and the joint solve for velocities.

Modules here import `kernels.common`, `kernels.mps`, `kernels.mps.grid` and each other, but nothing from `kernels.dem`.
Start with `bodies`, which describes the arrays of aggregates, and go on with `coupling`, the parts of the joint solve.
"""
