"""Concretes described by their mix: reading of the description, and properties calculated from it."""
