"""The built-in capture: a toy room, a ray tracer that renders it, and its sound."""
