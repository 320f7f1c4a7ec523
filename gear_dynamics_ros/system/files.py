"""Files and folders that appear whole or not at all, and survive a loss of power.

Each is written under another name in the same folder (the draft), flushed to the disk, and then renamed.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import BinaryIO, TypeVar

from gear_dynamics_ros.errors import GearboxError, UsageError

DRAFT_SUFFIX = ".part"
_T = TypeVar("_T")


@contextmanager
def replace_file(path: Path) -> Iterator[BinaryIO]:
    """Stream to a file that replaces ``path`` when the block ends.

    If the block raises, an earlier file stays and no draft is left. A draft left by a killed process is
    removed. Raises OSError if the file can't be written.
    """
    draft = path.parent / f".{path.name}{DRAFT_SUFFIX}"
    draft.unlink(missing_ok=True)
    with _finished(draft.open("xb"), draft, lambda: draft.replace(path)) as stream:
        yield stream


def replace_text(path: Path, text: str) -> None:
    """Write ``text`` in UTF-8 to ``path``, as ``replace_file`` does. Raises OSError if that fails."""
    with replace_file(path) as stream:
        stream.write(text.encode())


@contextmanager
def output_file(path: Path) -> Iterator[BinaryIO]:
    """As ``replace_file``, but raises GearboxError with ``path`` instead of an OSError."""
    with _explained(path), replace_file(path) as stream:
        yield stream


@contextmanager
def replace_files(folder: Path, names: Iterable[str]) -> Iterator[Path]:
    """Folder to fill with files, which replace those named ``names`` in ``folder`` when the block ends.

    Of these, files that the block has not made are removed; all others in ``folder`` stay. If the block
    raises, ``folder`` stays as it was. The block must flush its files to the disk. Raises GearboxError
    instead of an OSError, also for one that the block raises.
    """
    draft = folder / f".new{DRAFT_SUFFIX}"
    with _explained(folder):
        folder.mkdir(parents=True, exist_ok=True)
        if draft.exists():  # a killed process left it
            shutil.rmtree(draft)
        draft.mkdir()
        try:
            yield draft
            for name in names:
                if (draft / name).exists():
                    (draft / name).replace(folder / name)
                else:
                    (folder / name).unlink(missing_ok=True)
            sync_folder(folder)
        finally:
            shutil.rmtree(draft, ignore_errors=True)  # an error under way says more


@contextmanager
def new_file(path: Path) -> Iterator[BinaryIO]:
    """Stream to a new file that appears at ``path`` when the block ends; an existing one is never changed.

    If the block raises, nothing is left. Raises UsageError if ``path`` or its draft exists, or the draft
    can't be created; GearboxError instead of an OSError while writing, also for one that the block raises.
    """
    draft = _draft_beside(path)
    stream = _created(draft, lambda: draft.open("xb"))
    with _explained(path), _finished(stream, draft, lambda: _rename_new(draft, path)):
        yield stream


@contextmanager
def new_named_file(path: Path) -> Iterator[Path]:
    """As ``new_file``, for a library that opens files by name: gives the name of the draft to make."""
    draft = _draft_beside(path)
    _created(draft, lambda: draft.open("xb")).close()
    with _published(draft, path, lambda: draft.unlink(missing_ok=True)):
        yield draft


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Folder to fill, which appears at ``path`` when the block ends; an existing one is never changed.

    The block must flush its files to the disk. If it raises, nothing is left. Raises the errors of
    ``new_file``.
    """
    draft = _draft_beside(path)
    _created(draft, draft.mkdir)
    # An error under way says more than one of removing the draft.
    with _published(draft, path, lambda: shutil.rmtree(draft, ignore_errors=True)):
        yield draft


def require_new(path: Path) -> None:
    """Raise UsageError if anything exists at ``path``."""
    if os.path.lexists(path):
        raise UsageError(
            f"'{path}' exists already and is not overwritten: choose another name or move it away"
        )


def sync_folder(path: Path) -> None:
    """Flush the names in a folder to the disk, so that new files survive a loss of power.

    Raises OSError if that fails.
    """
    _sync(path)


def _sync(path: Path) -> None:
    """Flush a file or a folder, whoever wrote it, to the disk."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def _draft_beside(path: Path) -> Path:
    require_new(path)
    return path.with_name(path.name + DRAFT_SUFFIX)


def _created(draft: Path, create: Callable[[], _T]) -> _T:
    """What ``create`` returns. Raises UsageError if it can't create ``draft``."""
    try:
        return create()
    except FileExistsError:
        raise UsageError(
            f"'{draft}' exists already: another process is writing it, or left it when it was killed: "
            "wait, or remove it"
        ) from None
    except FileNotFoundError:
        raise UsageError(
            f"the folder '{draft.parent}' does not exist: make it or choose another place"
        ) from None
    except OSError as error:
        raise UsageError(f"can't make '{draft}': {error.strerror}: choose a writable place") from error


@contextmanager
def _published(draft: Path, path: Path, discard: Callable[[], object]) -> Iterator[None]:
    """Let the block fill ``draft``, a file or a folder; then flush it and rename it to ``path``."""
    with _explained(path):
        try:
            yield
            _sync(draft)
            _rename_new(draft, path)
            sync_folder(path.parent)
        except BaseException:
            discard()
            raise


@contextmanager
def _finished(stream: BinaryIO, draft: Path, publish: Callable[[], object]) -> Iterator[BinaryIO]:
    """Give ``stream``, the open file ``draft``; then flush it to the disk and rename it by ``publish``."""
    try:
        yield stream
        stream.flush()
        os.fsync(stream.fileno())
        stream.close()
        publish()
        sync_folder(draft.parent)
    except BaseException:
        with suppress(OSError):  # closing flushes the buffer, which may fail; the draft is removed anyway
            stream.close()
        draft.unlink(missing_ok=True)
        raise


def _rename_new(draft: Path, path: Path) -> None:
    require_new(path)
    draft.rename(path)


@contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn an OSError into a GearboxError that names ``path``."""
    try:
        yield
    except OSError as error:
        raise GearboxError(
            f"can't write '{path}': {error.strerror or error}: free space or choose another place"
        ) from error
