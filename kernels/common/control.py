"""Indices into the integer control array `flags` (one row per scene), which the kernels of all methods share."""

import warp as wp

HALTED: int = wp.constant(0)  # Nonzero if the scene is halted, so that all kernels of a step skip it.
STALE: int = wp.constant(1)  # Nonzero if the neighbour lists no longer cover every pair of bodies that may interact.
# Nonzero if the scene's state is no longer valid; each method defines its own error codes.
FAILED: int = wp.constant(2)
STEPS: int = wp.constant(3)  # Number of completed steps.
GOAL: int = wp.constant(4)  # Step count at which the scene halts.
OVERFLOW: int = wp.constant(5)  # Nonzero if a list of fixed size was too short.
# Nonzero if the neighbour lists became stale during the present step; the end of the step then sets STALE.
LATE: int = wp.constant(6)
ESTIMATED: int = wp.constant(7)  # Step count at which the stable time step was last estimated.
FLAGS = 8

# The next constants are the values of the flag HALTED in discrete-element scenes. They state why the scene is halted.
WAITS: int = wp.constant(1)  # The scene waits for new neighbour lists, or it has failed and cannot continue.
ARRIVED: int = wp.constant(2)  # The scene has reached its goal, or its stable time step must be estimated again.
