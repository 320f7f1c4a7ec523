"""The gallery's page is what its script writes, and its pictures are there and small."""

from __future__ import annotations

import re

import gallery
import numpy as np
from PIL import Image

DOCS = gallery.ROOT / "docs"
MOST_BYTES = 1_500_000


def test_the_page_is_of_today() -> None:
    assert (DOCS / gallery.PAGE).read_text(encoding="utf-8") == gallery.page(), "run: make gallery"


def test_the_pictures_show_something_and_are_small() -> None:
    named = set(re.findall(r"\((gallery_\w+\.png)\)", gallery.page()))
    assert named == {path.name for path in DOCS.glob("gallery_*.png")}
    for name in named:
        assert np.asarray(Image.open(DOCS / name).convert("L")).std() > 8.0, name
    assert sum((DOCS / name).stat().st_size for name in named) < MOST_BYTES
