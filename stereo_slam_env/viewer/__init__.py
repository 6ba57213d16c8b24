"""Figures: `plots` (paths, velocities, cost) and `consistency` (3-sigma bounds, NEES, NIS, depth)."""
