"""The Rerun viewer without a screen: what it shows, and pictures of it.

It needs a Vulkan driver; Mesa's in software will do.
"""

from __future__ import annotations

import io
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from support.domains import free_port
from support.processes import processes, until

Picture = NDArray[np.uint8]
DRIVERS = [Path(folder) / "vulkan" / "icd.d" for folder in ("/usr/share", "/etc", "/usr/local/share")]
COLOURED = 60  # of 255, by which the channels of a coloured pixel differ
BRIGHT = 150  # of 255, from which on a pixel on the dark ground is a letter


def without_viewer() -> str:
    """Why no picture of the viewer can be taken here; empty if one can."""
    if find_spec("rerun") is None:
        return "Rerun is not installed"
    if "VK_ICD_FILENAMES" in os.environ or any(
        folder.glob("*.json") for folder in DRIVERS if folder.is_dir()
    ):
        return ""
    return "no Vulkan driver for the Rerun viewer: apt-get install mesa-vulkan-drivers"


needs_viewer = pytest.mark.skipif(bool(without_viewer()), reason=without_viewer())


class ShownView(NamedTuple):
    """One view of the layout that the viewer shows."""

    name: str
    kind: str
    identity: str
    complaints: list[str]


class RerunWindow:
    """A viewer that runs, by its client; ``send`` sends a file to it and waits until it is sent."""

    def __init__(self, client: Any, send: Callable[[Path], None]) -> None:
        self._client = client
        self._send = send

    def show(self, file: Path, view: str) -> None:
        """Show a recording, or a layout of the one shown, and wait for its view with the name ``view``."""
        self._send(file)
        until(lambda: view in {shown.name for shown in self.views()}, f"{file.name} shows {view}")

    def views(self) -> list[ShownView]:
        return [
            ShownView(
                view.name,
                view.view_class,
                view.view_id,
                [f"{report.severity}: {report.summary}" for report in view.reports],
            )
            for view in self._client.get_state().views
            if view.visible
        ]

    def picture(self, view: ShownView | None = None) -> Picture | None:
        """What a view shows now, or the whole window: shape (height, width, 3); None before it is drawn."""
        try:
            encoded = self._client.take_screenshot(view.identity if view else None)
        except ConnectionError:
            return None
        return np.asarray(Image.open(io.BytesIO(encoded)).convert("RGB"))

    def hold(self, timeline: str, time: float) -> None:
        """Show this time in s of a timeline, and stay there."""
        self._client.set_time(timeline, duration=time, play_state="paused")

    def errors(self) -> list[str]:
        """What the viewer has complained about; that it draws in software is none."""
        return [entry.message for entry in self._client.get_logs() if entry.level == "ERROR"]


@contextmanager
def rerun_window(scratch: Path, size: tuple[int, int] = (1600, 900)) -> Iterator[RerunWindow]:
    """An empty viewer that listens on the loopback interface only; ``scratch`` is its home."""
    from rerun.experimental import ViewerClient

    port = free_port()
    # The home has no consent to analytics, and an application's viewer doesn't ask for it.
    home = {"XDG_CONFIG_HOME": str(scratch), "XDG_DATA_HOME": str(scratch), "RERUN_APP_ONLY": "true"}
    with processes() as start:

        def send(file: Path) -> None:
            # Rerun hands a file to the viewer that has the port already. With several files in one command,
            # either layout may be shown in the end.
            sender = start("rerun", file, "--port", port, **home)
            assert sender.wait(120.0) == 0, sender.output

        viewer = start(
            *("rerun", "--headless", "--bind", "127.0.0.1", "--port", port),
            *("--window-size", "{}x{}".format(*size)),
            **home,
        )
        viewer.wait_for("Headless viewer running", timeout=120.0)
        yield RerunWindow(ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy"), send)


def shown_share(view: ShownView, picture: Picture) -> float:
    """Share of a view's columns that show something: letters in a text, colours everywhere else.

    Scales and legends in the left tenth and below don't count.
    """
    height, width, _ = picture.shape
    inside = picture[: int(0.85 * height), int(0.1 * width) :].astype(int)
    if "Text" in view.kind:
        marked = inside.min(axis=2) > BRIGHT
    else:
        marked = inside.max(axis=2) - inside.min(axis=2) > COLOURED
    return float(marked.any(axis=0).mean())
