"""Statistics of the benchmark: differences between runs, with intervals and tests."""
