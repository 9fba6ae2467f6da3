"""Reconstruction of captures into reels."""
