"""Baselines on our kernels: other methods, rebuilt small, written as reels so that the same code decodes and measures them."""
