"""The simulated world: what is in the scene, where the camera drives, and the physics engine behind it."""
