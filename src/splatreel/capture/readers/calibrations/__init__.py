"""Calibrations of other programs, one file per format, and their pairing with videos and images."""
