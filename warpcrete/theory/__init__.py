"""Closed-form solutions for pipe flow, test vessels, heaps and suspensions, independent of any simulation method.

Modules here import `core` and each other. To read the code, start with `pipe`, and go on with `vessels`.
"""
