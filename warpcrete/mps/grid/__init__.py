"""Flows whose equations are solved on a grid, through which particles carry the concrete.

Modules here import the packages that `mps` imports, and also `mps.common`, but no other part of `mps`. To read the
code, start with `flow`, which contains the algorithm of one step, and go on with `layout` and `geometry`.
"""
