"""Readers of captures: videos, images, sound, camera poses, calibration and synchronization."""
