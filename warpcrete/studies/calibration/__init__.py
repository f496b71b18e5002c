"""Calibration: fit parameters of a concrete to measured values, with a Bayesian posterior.

Modules here import `core`, `methods`, `record`, `scenes` and the modules of `studies` itself. Start with `calibrate`.
"""
