"""Flow of concrete through a part of a pump line (straight, bend, reducer, or bore from a mesh), on a grid.

Modules here import the packages that `mps` imports, `mps.grid`, `mps.free` and the modules of `mps` itself. Start with
`scene`, and go on with `layout`.
"""
