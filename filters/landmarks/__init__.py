"""Landmark parametrisations: one file each, all offering `LandmarkModel`."""
