"""Warp kernels that every method uses."""
