"""Warp kernels and device functions that all simulation methods share."""
