"""Initial points and measures of a scene, from its first frame."""
