"""Flows whose equations are solved on a grid that particles are carried through."""
