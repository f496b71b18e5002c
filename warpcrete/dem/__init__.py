"""Discrete element method: aggregates are rigid bodies, and contact forces between them represent the mortar.

Modules here import `core`, `geometry`, `theory`, `mix`, `standards`, `kernels.common` and `kernels.dem`, but nothing
from `mps`. Start with `simulation`, which prepares and runs a scene, then read `engine.stepper`.
"""
