"""Warp kernels of discrete elements."""
