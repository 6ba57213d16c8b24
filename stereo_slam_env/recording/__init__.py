"""Recordings: what a filter is given, its archive, and sequences of stereo images."""
