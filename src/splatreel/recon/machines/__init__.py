"""Where the chapters of a run are made: in processes of this machine, by tasks of a batch system, on a Ray cluster."""
