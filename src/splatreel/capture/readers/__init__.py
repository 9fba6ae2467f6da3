"""Readers of capture layouts, one file per layout."""
