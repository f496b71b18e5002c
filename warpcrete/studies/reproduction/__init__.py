"""Reproduction of the results of the two source papers, with a verdict on each of their claims.

Modules here import `core`, `scenes` and the modules of `studies` itself. Start with `papers`, which lists cases and
claims.
"""
