"""Live reconstruction: following a capture while it is written."""
