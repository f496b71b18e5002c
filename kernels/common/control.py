"""Slots of the integer control array `flags`, one row a scene, which the kernels of every method share."""

import warp as wp

HALTED = wp.constant(0)  # every kernel of a step passes the scene by; why stands below
STALE = wp.constant(1)  # the neighbour lists no longer cover every pair that may matter
FAILED = wp.constant(2)  # the state left the range in which it means anything; what exactly is the method's to say
STEPS = wp.constant(3)  # completed steps
GOAL = wp.constant(4)  # step count at which the scene halts
OVERFLOW = wp.constant(5)  # a list of fixed size was too short
LATE = wp.constant(6)  # set within a step; becomes STALE when the step is complete
ESTIMATED = wp.constant(7)  # step count at which the stable step was estimated last
FLAGS = 8

# Why a scene of discrete elements is HALTED.
WAITS = wp.constant(1)  # for its lists, or for ever
ARRIVED = wp.constant(2)  # at its goal, or where the stable step must be estimated
