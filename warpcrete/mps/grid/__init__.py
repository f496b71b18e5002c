"""Flows whose equations are solved on a grid, through which particles carry the concrete."""
