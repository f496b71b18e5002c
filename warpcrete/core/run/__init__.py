"""The life of one run: the loop over time, recorders, checkpoints, run folders, provenance and progress.

Modules here import the other packages of `core`, but no simulation method. Start with `run_loop`: its class
`Simulation` is the base class of the simulations of all simulation methods.
"""
