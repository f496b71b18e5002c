"""Geometry for flows and discrete elements: pipe axes, triangle meshes, walls, and pipelines that are read from files.

Modules here import `core`, `kernels.common` and each other. Start with `axis`, and go on with `walls` (surfaces that
bodies touch) and `lines` (pump lines).
"""
