"""The time stepping of discrete elements: arrays on the device, neighbour lists, bonds, batches and the stable step.

Modules here import `core`, `geometry`, `dem.scene`, `dem.laws` and the kernels, but no measurement. Start with
`stepper`, go on with `stages`, which defines the algorithm of one step, and with `neighbors` for the neighbour lists.
"""
