"""Warp kernels of the discrete element method (DEM): contacts, bonds, neighbour lists, motion and measurements.

Modules here import `kernels.common` and each other. Start with `structs`, which describes all arrays, and go on with
`contacts` (CPU) and `links` (GPU), which compute the contact forces of a step.
"""
