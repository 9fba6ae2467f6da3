"""The paper's codec: quantized attributes, codebook, Draco positions and H.265 motion."""
