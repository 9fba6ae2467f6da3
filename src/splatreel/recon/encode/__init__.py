"""Encoding of checkpoints to reels: choice of quantization steps, sound, and writing of finished groups."""
