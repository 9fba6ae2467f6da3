"""Calibration and synchronization of the cameras of a capture."""
