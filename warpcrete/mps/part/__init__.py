"""Flow of concrete through a part of a pump line (straight, bend, reducer, or bore from a mesh), on a grid."""
