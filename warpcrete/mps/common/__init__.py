"""Code that flows of every kind share: stepping, runs, forecasts, concretes and settings.

This package is a part of `mps`. Its modules may import the same packages outside `mps` as all modules of `mps`, such as
`core` and `theory`, but no other part of `mps`. To read the code, start with `stepping`, which advances a flow by
launch graphs, and go on with `run`, the base class of a simulation.
"""
