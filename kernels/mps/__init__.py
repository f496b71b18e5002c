"""Warp kernels of flows: operators and solves of the implicit moving particle method (MPS), and flows on a grid.

Modules here import `kernels.common` and each other. Start with `structs`, which describes all arrays, and go on with
`operators` and `conjugate_gradient`.
"""
