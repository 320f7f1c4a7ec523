"""What a command printed."""

from __future__ import annotations

import pytest


def error_line(capsys: pytest.CaptureFixture[str], program: str = "replay") -> str:
    """The one line with which ``program`` refused or failed; it printed nothing else."""
    shown = capsys.readouterr()
    assert shown.err.startswith(f"{program}: error: ") and shown.err.count("\n") == 1
    assert shown.out == ""
    return shown.err
