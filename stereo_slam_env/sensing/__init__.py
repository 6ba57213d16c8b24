"""Simulated sensors, their noise and their faults."""
