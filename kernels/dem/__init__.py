"""Warp kernels of the discrete element method (DEM)."""
