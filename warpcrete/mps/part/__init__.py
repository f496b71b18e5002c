"""Flow of concrete through a part of a pump line (straight, bend, reducer, or bore from a mesh), on a grid.

Modules here import the packages that `mps` imports, and also `mps.grid` and `mps.common`. To read the code, start with
`scene`, and go on with `layout`.
"""
