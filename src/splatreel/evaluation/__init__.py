"""Evaluation of reels: metrics and reports."""
