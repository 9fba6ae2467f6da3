"""Settings that must be in place before numba and torch load their OpenMP runtimes."""

import os
import signal

# With another process on a core, spinning at barriers makes every parallel region wait for a whole scheduler tick.
os.environ.setdefault("GOMP_SPINCOUNT", "0")

# A shell starts what runs in its background deaf to Ctrl-C, and the commands under test would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)
