"""Calibration: fit parameters of a concrete to measured values, with a Bayesian posterior.

Modules here run studies of scenes and import `dem`, `mps`, `theory` and `record`. Start with `calibrate`.
"""
