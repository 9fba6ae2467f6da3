"""Films of Gaussians that other programs made, one set a frame, turned into reels."""
