"""Description of a scene of discrete elements: bodies, clumps, sizes, containers, bonds, walls in strokes.

Modules here import `core`, `geometry`, `mix` and `dem.laws`; they hold no device arrays. Start with `scene`.
"""
