"""What led from one stored checkpoint to the next, as a digest that the next one carries.

A re-simulation makes the samples again. It can't make again what people and programs did: commands as they
came, events, descriptions, reports, and entries of a checkpoint that nothing reads again. The digest shows
whether these were altered.
"""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from typing import Final

from gear_dynamics_ros.topics import OF_A_CHUNK, TOPICS

# Keys in TOPICS of what is no work of a chunk.
TOLD: Final[Collection[str]] = frozenset(TOPICS) - frozenset(OF_A_CHUNK)


class RunningDigest:
    """SHA-256 of the attachments of a checkpoint, and of the messages on the topics TOLD that follow it."""

    def __init__(self, *opening: bytes) -> None:
        self._digest = hashlib.sha256()
        for content in opening:
            self._add(content)

    def add(self, topic: str, time_ns: int, data: bytes | memoryview) -> None:
        """Take in the next message, on the topic with this full name."""
        self._add(topic.encode())
        self._digest.update(time_ns.to_bytes(8, "little", signed=True))
        self._add(data)

    def text(self) -> str:
        """Of all so far, in hexadecimal."""
        return self._digest.hexdigest()

    def _add(self, content: bytes | memoryview) -> None:
        # With its length, or two contents could share their bytes otherwise.
        self._digest.update(len(content).to_bytes(8, "little"))
        self._digest.update(content)
