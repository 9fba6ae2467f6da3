"""Motion layering: separation of static from dynamic Gaussians, tracking and relighting."""
