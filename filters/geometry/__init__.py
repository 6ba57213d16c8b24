"""Cameras, poses, rotations, retractions and differences: the geometry that all parts share."""
