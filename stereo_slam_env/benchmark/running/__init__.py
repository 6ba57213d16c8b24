"""Tasks of a benchmark, the backends that run them, and processes of their own."""
