"""The life of one run: the loop over time, recorders, checkpoints, run folders, provenance and progress.

Modules here import the other packages of `core`, but no solver. Start with `run_loop`, whose class `Simulation` both
solvers extend.
"""
