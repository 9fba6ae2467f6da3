"""Numba kernels on numpy arrays; nothing in here imports torch, except `autograd`."""
