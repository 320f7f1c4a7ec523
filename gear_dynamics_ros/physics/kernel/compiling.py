"""How the functions of this folder are compiled, and which entry of numba's cache fits them.

numba's cache hashes the bytecode and the closure of the function that Python calls, and nothing of what that
function calls. So entry points alone are cached, and they close over ``CACHE_KEY``: an edit of any file of
this folder, or of the columns it writes to, makes another key, and the functions are compiled afresh.

A cache that can't be read or written costs time and no run. What happens is logged under this module's name:
a compilation as INFO, trouble with the cache as WARNING, each once a process.
"""

from __future__ import annotations

import contextlib
import hashlib
import logging
import pickle
from functools import cache
from pathlib import Path
from types import CellType, FunctionType
from typing import Any, ClassVar, Final

from numba import njit
from numba.core.caching import CompileResultCacheImpl, FunctionCache, InTreeCacheLocator
from numba.core.serialize import dumps

from gear_dynamics_ros.physics.kernel.columns import FROZEN
from gear_dynamics_ros.physics.kernel.sources import kernel_hash

CACHE_KEY = hashlib.sha256(f"{kernel_hash()} {FROZEN}".encode()).hexdigest()
LOG: Final = logging.getLogger(__name__)

# Contraction to fused multiply-add is allowed, reassociation is not: the bits follow from the source.
compiled = njit(fastmath={"contract"}, error_model="numpy")
# For a function that is small, or whose caller uses only part of what it returns.
inlined = njit(fastmath={"contract"}, error_model="numpy", forceinline=True)
# For a function whose rounding matters.
uncontracted = njit(error_model="numpy")


class _UnwritableLocator(InTreeCacheLocator):
    """The cache beside the source, where it can be read only; numba itself would take none."""

    @classmethod
    def from_function(cls, py_func: Any, py_file: str) -> _UnwritableLocator:
        return cls(py_func, py_file)


class _Implementation(CompileResultCacheImpl):
    """Stores a digest with the compiled code: a flipped bit in it would be executed."""

    _locator_classes: ClassVar = [  # type: ignore[misc]
        *CompileResultCacheImpl._locator_classes,
        _UnwritableLocator,
    ]

    def reduce(self, data: Any) -> tuple[bytes, bytes]:
        code: bytes = dumps(super().reduce(data))  # type: ignore[no-untyped-call]
        return hashlib.sha256(code).digest(), code

    def rebuild(self, target_context: Any, payload: tuple[bytes, bytes]) -> Any:
        digest, code = payload
        if hashlib.sha256(code).digest() != digest:
            raise ValueError("its digest is another")
        return super().rebuild(target_context, pickle.loads(code))  # type: ignore[no-untyped-call]


class _PatientCache(FunctionCache):
    """numba's cache of one function; where it fails, the function is compiled, and the reason is logged."""

    _impl_class = _Implementation

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        try:
            found = super().load_overload(sig, target_context)  # type: ignore[no-untyped-call]
        except OSError:  # what can't be read, and not be written either, is logged then
            self._forget()
            found = None
        except Exception as error:  # of a damaged pickle anything may come
            _log_once(
                logging.WARNING,
                f"the compiled kernel in '{self.cache_path}' is damaged ({_reason(error)}): it is compiled "
                "anew; if this comes again, set NUMBA_CACHE_DIR to another folder",
            )
            self._forget()
            found = None
        if found is None:
            _log_once(logging.INFO, "compiling the kernel, which can take a minute")
        return found

    def save_overload(self, sig: Any, data: Any) -> None:
        try:
            super().save_overload(sig, data)  # type: ignore[no-untyped-call]
        except Exception as error:  # also reads the index, see above
            _log_once(
                logging.WARNING,
                f"the compiled kernel can't be kept in '{self.cache_path}' ({_reason(error)}): every start "
                "compiles it anew; set NUMBA_CACHE_DIR to a folder that can be written to and has 10 MB free",
            )

    def _forget(self) -> None:
        """Remove the index, without which numba overwrites the files of the cache."""
        with contextlib.suppress(OSError):  # what can't be removed can't be kept either, which is logged
            Path(self._cache_file._index_path).unlink(missing_ok=True)


def entry_point(function: Any) -> Any:
    """Decorator of a function that Python calls: compiled without Python's lock, and cached on disk."""
    # A closure of one variable that the function never reads: numba's cache hashes it.
    code = function.__code__.replace(co_freevars=("cache_key",))
    keyed = FunctionType(code, function.__globals__, closure=(CellType(CACHE_KEY),))
    dispatcher: Any = njit(nogil=True, fastmath={"contract"}, error_model="numpy")(keyed)
    # What cache=True does, with numba's own class.
    dispatcher._cache = _PatientCache(keyed)  # type: ignore[no-untyped-call]
    return dispatcher


def _reason(error: Exception) -> str:
    return getattr(error, "strerror", None) or " ".join(f"{type(error).__name__}: {error}".split())[:200]


@cache
def _log_once(level: int, text: str) -> None:
    LOG.log(level, text)
