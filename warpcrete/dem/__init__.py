"""Discrete element method: rigid aggregates whose contacts represent the mortar between them.

Modules here import `core`, `geometry`, `theory`, `mix`, `kernels.common` and `kernels.dem`, but nothing of `mps`. Start
with `simulation`, which prepares and runs a scene, and go on with `engine.stepper`.
"""
