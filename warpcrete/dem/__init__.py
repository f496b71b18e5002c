"""Discrete element method: rigid aggregates whose contacts represent the mortar between them."""
