"""Recorders and readers of runs: run folders, Rerun recordings, USD scenes, ParaView files, pictures and notebooks.

Modules here import `core`, `geometry`, `scenes` and `methods`, and know a simulation method only by its interface.
Start with `recorders`, which lists all recorders, and go on with `run_folder` and `loading`.
"""
