"""Findings about the cameras: poses, color gains, exposures, time offsets."""
