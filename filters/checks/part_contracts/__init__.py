"""Checks of parts: one file a kind, collected in `filters.checks.part_checks`."""
