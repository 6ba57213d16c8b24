"""State of the filters: named variables, map and covariance."""
