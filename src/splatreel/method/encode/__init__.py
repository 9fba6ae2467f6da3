"""Choice of quantization steps, and the importance of points."""
