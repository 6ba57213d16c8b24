"""What is sure: differences between runs, with intervals and tests."""
