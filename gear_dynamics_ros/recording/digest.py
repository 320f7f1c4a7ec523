"""Digest of the content between two checkpoints, stored in the second one.

A re-simulation computes the messages of chunks again. It can't compute the others: received commands, events,
descriptions, reports, and entries of a checkpoint that are not read again. The digest shows whether these
were altered.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from typing import Final

from gear_dynamics_ros.topics import CHUNK_TOPICS, TOPICS

# Topics (keys in TOPICS) whose messages no chunk makes.
INPUT_TOPICS: Final[Collection[str]] = frozenset(TOPICS) - frozenset(CHUNK_TOPICS)


class RunningDigest:
    """SHA-256 of the content of a checkpoint, and of the messages on INPUT_TOPICS after it."""

    def __init__(self, *contents: bytes) -> None:
        """Begin with ``contents``, the texts that hold the checkpoint."""
        self._digest = hashlib.sha256()
        for content in contents:
            self._add(content)

    def add(self, topic: str, time_ns: int, data: bytes | memoryview) -> None:
        """Add the next message; ``topic`` is the full name, ``data`` CDR."""
        self._add(topic.encode())
        self._digest.update(time_ns.to_bytes(8, "little", signed=True))
        self._add(data)

    def text(self) -> str:
        """Digest of everything added so far, hexadecimal."""
        return self._digest.hexdigest()

    def _add(self, content: bytes | memoryview) -> None:
        # The length is added too: otherwise bytes could move from one content to the next unnoticed.
        self._digest.update(len(content).to_bytes(8, "little"))
        self._digest.update(content)
