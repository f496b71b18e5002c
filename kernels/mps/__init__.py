"""Warp kernels of the implicit moving particle method (MPS)."""
