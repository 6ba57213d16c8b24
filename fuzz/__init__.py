"""Input that nobody meant: every reader of files under random and coverage-guided mutations. See `fuzz/run.py`."""
