"""Training of keyframes and groups: losses, density control, drawing and schedules."""
