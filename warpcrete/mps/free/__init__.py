"""Standard tests of fresh concrete with a free surface, as flows on a grid.

This package is a part of `mps`. Its modules may import the same packages outside `mps` as all modules of `mps`, such as
`core` and `theory`. Inside `mps` they may import `mps.grid` and `mps.common`. To read the code, start with `scene`,
and go on with `quantities`, which lists the results.
"""
