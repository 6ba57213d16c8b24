"""Checks of parts: one file a kind, collected in `filters.part_checks`."""
