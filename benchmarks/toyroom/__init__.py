"""The built-in capture: a toy room, a ray tracer that renders it, and its sound. Other films use the ray tracer too."""
