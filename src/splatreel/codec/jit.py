"""How the codec's loops are compiled: exactly, so that every decoder finds the same numbers, and beside other threads."""

from typing import Any

from splatreel.compile_cache import choose_compile_cache

choose_compile_cache()

EXACT: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}
"""Without `fastmath`: the format says which sums of doubles are taken in which order."""
