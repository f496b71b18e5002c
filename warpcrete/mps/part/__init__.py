"""Concrete that fills a part of a line: a straight, a bend, a reducer, or a bore from a mesh, as a flow on a grid."""
