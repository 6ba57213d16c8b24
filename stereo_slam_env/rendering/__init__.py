"""From a scene and a pose to stereo images."""
