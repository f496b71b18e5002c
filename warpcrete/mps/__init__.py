"""Implicit moving particles: concrete as a Bingham fluid with a slip layer."""
