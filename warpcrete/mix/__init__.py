"""Mixes of concrete: their files, and the properties of concrete, mortar and slip layer that follow from them.

Modules here import `core`, `geometry`, `theory` and each other. To read the code, start with `mix`, and go on with
`rheology`.
"""
