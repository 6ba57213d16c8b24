"""The figures of a run, and their theoretical limits."""
