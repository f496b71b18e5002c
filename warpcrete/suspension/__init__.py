"""Aggregates suspended in a mortar: rigid bodies inside the viscous solve of a grid flow.

Modules here import `core`, `geometry`, `theory`, `kernels`, `mps` and `dem`; `mps` and `dem` do not import this
package. Start with `flow`, which contains one time step, and go on with `solve`.
"""
