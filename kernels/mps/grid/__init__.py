"""Warp kernels of flows that are solved on a grid, with particles that carry the fluid through it."""
