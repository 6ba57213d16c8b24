"""Ways to linearise a measurement for the update: one file each, all `Linearisation`."""
