"""Bytes in and out: quantisation, point clouds, offset codecs, the manifest, reading and writing reels. No torch."""
