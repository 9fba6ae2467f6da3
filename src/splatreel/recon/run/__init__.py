"""Files, locks, plan, device, time and memory of a run."""
