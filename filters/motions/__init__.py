"""Motion models: one file each, all `MotionModel`."""
