"""Stages of the reconstruction of a group, one class per stage."""
