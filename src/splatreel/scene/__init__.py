"""Plain numpy types of a scene: cameras, Gaussians, groups, and their file formats."""
