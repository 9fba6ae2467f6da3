"""Output of a run: layers and groups from checkpoints to the files of a reel."""
