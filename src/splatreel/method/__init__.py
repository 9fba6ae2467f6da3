"""The paper's method: what is computed for a group of frames, without files or processes."""
