"""The life of one run: the loop over time, recorders, checkpoints, run folders, provenance and progress.

Modules here import the other packages of `core`, but no simulation method. Start with `run_loop`: its class
`Simulation` runs the simulations of all methods. Its base class in `simulation_base` lists what a method defines.
"""
