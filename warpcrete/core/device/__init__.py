"""Devices, and the ways in which work reaches them: kernel launches, CUDA graphs, CPU threads, asynchronous copies,
interrupts.

Modules here import only Warp, NumPy, `kernels.common`, `core.errors` and each other. Start with `launching`, which
turns a kernel and its arguments into a stage of a time step.
"""
