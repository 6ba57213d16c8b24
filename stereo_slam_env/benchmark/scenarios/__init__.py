"""Scenarios and studies as plain data, from files and as presets, and their measurement streams."""
