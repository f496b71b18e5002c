"""Warp kernels of flows that are solved on a grid, with particles that carry the concrete through it.

Modules here import `kernels.common`, the solvers in `kernels.mps` and each other. Start with `cells`, which describes
grid and arrays, and go on with `forces` and `pressure`.
"""
