"""Words that a user may have meant, and texts cut to what a message can show."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Final

LONGEST: Final = 100  # characters


def most_alike(word: str, known: Iterable[str]) -> str:
    """The one of ``known`` that is most like ``word``; empty if none is.

    None is like a long word: to find that out would take minutes, and a peer can send any text.
    """
    if len(word) > LONGEST:
        return ""
    return next(iter(difflib.get_close_matches(word, list(known), n=1)), "")


def shortened(text: str) -> str:
    """The begin of ``text``, with dots where it is cut off."""
    return text if len(text) <= LONGEST else f"{text[:LONGEST]}..."
