"""Axes, meshes and walls: one description for every method."""
