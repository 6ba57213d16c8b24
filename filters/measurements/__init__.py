"""Measurement models: one file each, all offering `MeasurementModel`."""
