"""Vision front end: (u, v, d) with ids from stereo images."""
