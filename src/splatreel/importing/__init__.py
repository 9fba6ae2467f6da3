"""Import of Gaussian sequences from other programs, one set of Gaussians per frame, as reels."""
