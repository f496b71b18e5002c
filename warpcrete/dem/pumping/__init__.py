"""Declared parameters of pumping pipes, parts and test vessels, and the scenes that follow from them.

Modules here import `core`, `geometry`, `theory`, `standards`, `dem.scene` and `dem.laws`, but no module that runs a
scene. Start with `parameters`.
"""
