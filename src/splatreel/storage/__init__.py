"""Access to folders on this machine, in a bucket or on another machine."""
