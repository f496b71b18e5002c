"""Aggregates in a mortar that flows through a stretch of an endless pipe.

The two ends of the stretch are connected: what leaves one end enters the other. To read the code, start with `scene`,
and go on with `simulation`.
"""
