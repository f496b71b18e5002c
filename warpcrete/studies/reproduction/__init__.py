"""Reproduction of the results of the two source papers, with a verdict on every claim.

Modules here run studies of the papers' cases. Start with `papers`, which lists cases and claims.
"""
