"""Aggregates in a mortar that flows through a part of a pump line: straights, bends, reducers and bores from meshes.

Aggregates enter with the mortar through a plane at the start of the part, and leave through its open end. This package
is a part of `suspension`. Its modules may import the same packages as all modules of `suspension`, and the modules of
`suspension` itself, but not `suspension.stretch`. To read the code, start with `scene`, and go on with `layout` and
`simulation`.
"""
