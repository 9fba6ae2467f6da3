"""A simulated GPU: code for CUDA runs on it, and mixing tensors of two devices raises the same errors as on a GPU."""
