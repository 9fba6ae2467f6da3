"""Deformation models: motion and appearance of dynamic points over the frames of a group."""
