"""Numba kernels on numpy arrays. No module here imports torch, except `autograd`."""
