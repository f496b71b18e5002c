"""Concrete with a free surface: standard tests as flows on a grid."""
