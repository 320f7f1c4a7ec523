"""Files that survive a loss of power, or were never there."""

from __future__ import annotations

import os
from pathlib import Path


def replace_text(path: Path, text: str) -> None:
    """Write ``text`` to ``path``; an earlier file there is replaced in one moment or stays.

    Raises OSError if it can't be written; nothing is left behind then.
    """
    draft = path.parent / f".{path.name}.part"
    try:
        draft.unlink(missing_ok=True)
        with draft.open("x", encoding="utf-8") as stream:
            stream.write(text)
            stream.flush()
            os.fsync(stream.fileno())
        draft.replace(path)
    except OSError:
        draft.unlink(missing_ok=True)
        raise
    sync_folder(path.parent)


def sync_folder(path: Path) -> None:
    """Bring the names in a folder to the disk: only with its name does a file survive a loss of power."""
    folder = os.open(path, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)
