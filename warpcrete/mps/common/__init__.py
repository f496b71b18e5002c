"""Code that flows of every kind share: stepping, runs, forecasts, concretes and settings.

Modules here import the packages that `mps` imports, but no other part of `mps`. To read the code, start with
`stepping`, which advances a flow by launch graphs, and go on with `run`, the base class of a simulation.
"""
