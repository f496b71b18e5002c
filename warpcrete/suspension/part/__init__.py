"""Aggregates in a mortar that flows through a part of a pump line: straights, bends, reducers and bores from meshes.

Aggregates enter with the mortar through a plane at the start of the part, and leave through its open end. To read the
code, start with `scene`, and go on with `layout` and `simulation`.
"""
