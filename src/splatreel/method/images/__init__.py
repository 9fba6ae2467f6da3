"""Measurements in images: optical flow, change, exposure, clean plates."""
