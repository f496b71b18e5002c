"""Aggregates in a mortar that flows through a stretch of an endless pipe.

The two ends of the stretch are connected: what leaves one end enters the other. This package is a part of `suspension`.
Its modules may import the same packages as all modules of `suspension`, and the modules of `suspension` itself, but not
`suspension.part`. To read the code, start with `scene`, and go on with `simulation`.
"""
