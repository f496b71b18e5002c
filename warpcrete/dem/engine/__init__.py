"""Time stepping of discrete elements: arrays on the device, neighbour lists, bonds, batches and the stable time step.

Modules here import `core`, `geometry`, `dem.scene`, `dem.laws` and the kernels, but not `dem.measure`. A reader
should begin with `stepper`, then read `stages`, which defines the algorithm of one step, and then `neighbors`,
which builds the neighbour lists.
"""
