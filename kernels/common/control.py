"""Indices into the integer control array `flags` (one row per scene), which the kernels of all methods share."""

import warp as wp

# HALTED is the index of the flag that is nonzero if the scene is halted, so that all kernels of a step skip the scene.
HALTED: int = wp.constant(0)
# STALE is the index of the flag that is nonzero if the neighbour lists may lack a pair of bodies that may interact.
STALE: int = wp.constant(1)
# FAILED is the index of the flag that is nonzero if the scene's state is no longer valid. Each method defines its own
# error codes.
FAILED: int = wp.constant(2)
STEPS: int = wp.constant(3)  # Index in `flags` of the number of completed steps.
GOAL: int = wp.constant(4)  # Index in `flags` of the step count at which the scene halts.
OVERFLOW: int = wp.constant(5)  # Index of the flag that is nonzero if a list of fixed size was too short.

# LATE is the index of the flag that is nonzero if the neighbour lists became stale during the present step. The end of
# the step then sets STALE.
LATE: int = wp.constant(6)
ESTIMATED: int = wp.constant(7)  # Index in `flags` of the step count at which the stable time step was last estimated.
FLAGS = 8

# The next constants are the values of the flag HALTED in discrete-element scenes. They state why the scene is halted.

# Value of HALTED if the scene waits for new neighbour lists, or has failed and cannot go on.
WAITS: int = wp.constant(1)
# Value of HALTED if the scene has taken all its steps, or if the stable time step must be estimated again.
ARRIVED: int = wp.constant(2)
