"""Captures that are still being written."""
