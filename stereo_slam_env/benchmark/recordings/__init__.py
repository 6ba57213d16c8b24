"""What filters are given: where the measurements of a scenario come from."""
