"""The time stepping of discrete elements: arrays on the device, neighbour lists, bonds, batches and the stable step.

Modules here import `core`, `geometry`, `dem.scene`, `dem.laws` and the kernels, but not the modules that measure. A
reader should begin with `stepper`, then read `stages`, which defines the algorithm of one step, and then `neighbors`,
which builds the neighbour lists.
"""
