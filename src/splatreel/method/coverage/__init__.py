"""Coverage of the scene by the cameras, and the expected quality of novel views."""
