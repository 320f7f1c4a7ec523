"""Headless Chromium, where it is installed: pages as PDF and pictures, without any network."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

import pytest

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
needs_chromium = pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed")
OFFLINE = "--host-resolver-rules=MAP * ~NOTFOUND"


def print_to_pdf(page: Path, pdf: Path) -> None:
    """Print the HTML file ``page`` to ``pdf``."""
    _run(page, pdf.parent, "--no-pdf-header-footer", f"--print-to-pdf={pdf}")
    assert pdf.is_file()


def screenshot(page: Path, picture: Path, width: int, height: int) -> None:
    """Take a PNG of the upper ``width`` times ``height`` pixels of the HTML file ``page``."""
    _run(
        page,
        picture.parent,
        "--hide-scrollbars",
        f"--window-size={width},{height}",
        f"--screenshot={picture}",
    )
    assert picture.is_file()


def _run(page: Path, scratch: Path, *options: str) -> None:
    assert CHROMIUM is not None
    command = [CHROMIUM, "--headless=new", "--no-sandbox", "--disable-gpu", "--no-first-run", OFFLINE]
    place = f"--user-data-dir={scratch / 'chromium'}"
    done = subprocess.run(
        [*command, place, *options, page.resolve().as_uri()], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr


def pdf_pages(pdf: Path) -> int:
    """Number of pages of a PDF that Chromium has printed."""
    return len(re.findall(rb"/Type /Page(?![a-z])", pdf.read_bytes()))
