"""Warp kernels and device functions that all simulation methods share: types, geometry, walls, sums and barriers.

Modules here import only Warp, NumPy and each other. Start with `types`, and go on with `control`, which describes the
flags by which a device halts a scene.
"""
