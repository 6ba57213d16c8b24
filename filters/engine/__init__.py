"""The EKF: joint state, linear algebra of the update, error definitions, and the filter composed of them."""
