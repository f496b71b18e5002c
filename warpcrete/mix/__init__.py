"""Mixes of concrete: their files, and the properties of concrete, mortar and slip layer that follow from them.

Modules here import `core`, `theory` and each other. Readers of the code start with `mix.py`, then `rheology.py`.
"""
