"""Encoding and decoding of reels: quantization, codecs, manifest, readers and writers. Never imports torch."""
