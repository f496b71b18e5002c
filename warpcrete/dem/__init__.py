"""Discrete elements: rigid aggregates whose contacts stand for the mortar between them."""
