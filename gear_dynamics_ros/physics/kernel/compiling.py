"""How the functions of this folder are compiled, and which entry of numba's cache fits them.

numba's cache hashes the bytecode and the closure of the function that Python calls, and nothing of what that
function calls. So entry points alone are cached, and they close over ``CACHE_KEY``: an edit of any file of
this folder, or of the columns it writes to, makes another key, and the functions are compiled afresh.
"""

from __future__ import annotations

import hashlib
from types import CellType, FunctionType
from typing import Any

from numba import njit

from gear_dynamics_ros.physics.kernel.columns import FROZEN
from gear_dynamics_ros.physics.kernel.sources import kernel_hash

CACHE_KEY = hashlib.sha256(f"{kernel_hash()} {FROZEN}".encode()).hexdigest()

# Contraction to fused multiply-add is allowed, reassociation is not: the bits follow from the source.
compiled = njit(fastmath={"contract"}, error_model="numpy")
# For a function that is small, or whose caller uses only part of what it returns.
inlined = njit(fastmath={"contract"}, error_model="numpy", forceinline=True)
# For a function whose rounding matters.
uncontracted = njit(error_model="numpy")


def entry_point(function: Any) -> Any:
    """Decorator of a function that Python calls: compiled without Python's lock, and cached on disk."""
    # A closure of one variable that the function never reads: numba's cache hashes it.
    code = function.__code__.replace(co_freevars=("cache_key",))
    keyed = FunctionType(code, function.__globals__, closure=(CellType(CACHE_KEY),))
    return njit(cache=True, nogil=True, fastmath={"contract"}, error_model="numpy")(keyed)
