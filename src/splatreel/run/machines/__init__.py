"""Places where the chapters of a run are made: processes of this machine, tasks of a batch system, nodes of a Ray cluster."""
