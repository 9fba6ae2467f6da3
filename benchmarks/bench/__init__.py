"""Measurements of `measure.py` and `oracle.py`, which other benchmarks use too."""
