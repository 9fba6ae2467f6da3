"""Runs: groups and chapters in order, checkpoints, estimates, machines, live captures."""
