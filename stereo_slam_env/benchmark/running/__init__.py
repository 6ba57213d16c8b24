"""Filters on recordings: one run, many at once, each in a process of its own."""
