"""Base of all rooms: errors, progress, threads, processes, kernels, safe files and safe reading of untrusted input."""
