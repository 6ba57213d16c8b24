"""Rendering: stereo images of a scene from a pose."""
