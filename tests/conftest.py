"""Settings that must be in place before numba and torch load their OpenMP runtimes."""

import os

# With another process on a core, spinning at barriers makes every parallel region wait for a whole scheduler tick.
os.environ.setdefault("GOMP_SPINCOUNT", "0")
