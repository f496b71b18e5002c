"""Aggregates suspended in mortar: rigid spheres whose motion is solved together with the grid flow of the mortar.

Modules in this package import `core`, `geometry`, `theory`, `kernels`, `mps` and `dem`. `mps` and `dem` do not import
this package. `flow` contains one time step, and `solve` the solution of its equations.
"""
