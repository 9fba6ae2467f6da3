"""A GPU that is none: what runs on CUDA runs on it, with the same errors where tensors of two devices meet."""
