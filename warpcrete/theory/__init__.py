"""Closed-form solutions for pipe flow, test vessels, heaps and suspensions, independent of any simulation method."""
