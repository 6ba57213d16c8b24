"""Console tables and HTML pages of runs, studies and comparisons."""
