"""Closed forms: pipes, vessels and heaps, suspensions; of fluids, whatever method computes them."""
