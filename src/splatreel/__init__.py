"""Splatreel: volumetric video from many static cameras."""

__version__ = "0.1.0"
