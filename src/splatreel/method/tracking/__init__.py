"""Tracking of dynamic points through the frames of a group."""
