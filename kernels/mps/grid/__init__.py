"""Warp kernels of flows whose equations are solved on a grid."""
