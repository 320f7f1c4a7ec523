"""The hash of this folder's source, for numba's cache and for provenance; needs no compiler."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from functools import cache
from pathlib import Path


@cache
def kernel_hash() -> str:
    """SHA-256 of every source file of this folder, as hexadecimal text."""
    folder = Path(__file__).parent
    return hash_of_files(folder, folder.glob("*.py"))


def hash_of_files(folder: Path, paths: Iterable[Path]) -> str:
    """SHA-256 of the names of ``paths``, relative to ``folder``, and their content; in any order."""
    digest = hashlib.sha256()
    for path in sorted(paths):
        content = path.read_bytes()
        digest.update(f"{path.relative_to(folder).as_posix()} {len(content)}\n".encode() + content)
    return digest.hexdigest()
