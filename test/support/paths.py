"""Where the files stand that tests read."""

from __future__ import annotations

from pathlib import Path
from typing import Final

TESTS: Final = Path(__file__).resolve().parents[1]
ROOT: Final = TESTS.parent
CONFIG: Final = ROOT / "config"
CASES: Final = TESTS / "cases"
