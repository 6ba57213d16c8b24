"""Scenarios as plain data, from files and as presets, and the measurement streams they stand for."""
