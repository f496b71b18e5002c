"""Standard tests of fresh concrete with a free surface, as flows on a grid.

Modules here import the packages that `mps` imports, and also `mps.grid` and `mps.common`. To read the code, start with
`scene`, and go on with `quantities`, which lists the results.
"""
