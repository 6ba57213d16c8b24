"""Sensors: from the true world to what a filter is given."""
