"""Sources of recordings, one class a kind, and the reference problems."""
