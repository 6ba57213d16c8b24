"""Studies written with the benchmark: the paper's experiments and the fault matrix."""
