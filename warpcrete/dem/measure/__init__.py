"""Measurements during a run of discrete elements: series, stresses, segregation, blockage, wear, results.

Modules here import `core`, `geometry`, `standards`, `dem.scene`, `dem.engine` and the kernels; they read the arrays of
`dem.engine` and change none of them, except that `wear` resets the sums that it has read. Start with `sampling`, which
measures the rows of the time series, then read `quantities`, which computes the results of a run.
"""
