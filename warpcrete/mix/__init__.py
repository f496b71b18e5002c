"""Concretes described by their mix: reading of the description, and properties calculated from it.

Modules here import `core`, `theory` and each other. Start with `mix`, and go on with `rheology`.
"""
