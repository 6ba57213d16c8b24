"""Measurement models: one file a sensor, all `MeasurementModel`."""
