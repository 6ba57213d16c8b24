"""The vision front end: from stereo images to (u, v, d) with ids."""
