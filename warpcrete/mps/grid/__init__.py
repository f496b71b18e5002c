"""Flows whose equations are solved on a grid, through which particles carry the concrete.

This package is a part of `mps`. Its modules may import the same packages outside `mps` as all modules of `mps`, such as
`core` and `theory`. Inside `mps` they may import `mps.common`, but no other part. To read the code, start with
`flow`, which contains the algorithm of one step, and go on with `layout` and `geometry`.
"""
