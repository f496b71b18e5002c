"""Warp kernels of the moving particle method."""
