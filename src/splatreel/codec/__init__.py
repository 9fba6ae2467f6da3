"""Bytes in and out: quantization, point clouds, offset codecs, the manifest, reading and writing reels. No torch."""
