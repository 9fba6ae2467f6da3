"""Evaluation of reels: metrics, reports, and the measurements of the `bench` commands."""
