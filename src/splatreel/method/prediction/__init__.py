"""Prediction of the quality of novel views, before training, and the verdict of `capture check`."""
