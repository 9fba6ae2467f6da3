"""Calibration boards: printing, finding and measuring them."""
