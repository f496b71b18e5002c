"""Reproduction of the results of two papers (Zhan et al. 2019; Xu, Li & Jiang 2021), with a verdict on each claim.

Modules here import `core`, `scenes` and the modules of `studies` itself. Start with `papers`, which lists cases and
claims.
"""
