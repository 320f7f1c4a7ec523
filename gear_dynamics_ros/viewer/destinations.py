"""Where a run is shown: a file, a server on this machine, or a running viewer elsewhere."""

from __future__ import annotations

import importlib.util
import math
import os
import socket
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Final, Protocol
from urllib.parse import quote, urlsplit

import rerun as rr

from gear_dynamics_ros.errors import UsageError
from gear_dynamics_ros.parameters import Parameters
from gear_dynamics_ros.system.processes import start_child
from gear_dynamics_ros.viewer import blueprint
from gear_dynamics_ros.viewer.run_display import RunDisplay
from gear_dynamics_ros.viewer.thinning import Density

APPLICATION: Final = "gear_dynamics_ros"
SERVER_ADDRESS: Final = "127.0.0.1"
# What a server keeps for viewers that connect later, by Rerun's count; then it drops the oldest.
LIVE_MEMORY: Final = "96MiB"  # some minutes of a run
RECORDED_MEMORY: Final = "2GiB"  # any recording, at the density of a file
PROBE_TIMEOUT: Final = 0.5  # s of wall time
FULL_SPAN: Final = 60.0  # s of a run that a file has at full density
FILE_SEND_INTERVAL: Final = 2.0  # s of wall time between blocks of a file
LIVE_SEND_INTERVAL: Final = 0.0
STOP_TIMEOUT: Final = 5.0
OVERVIEW: Final = "overview"  # the layout that explains a run that has ended


class Destination(Protocol):
    """A place where one run is shown."""

    display: RunDisplay
    address: str  # for the user: a file or a URL
    send_interval: float  # s of wall time between two blocks of data

    def ready(self) -> bool:
        """Whether ``open`` may be called."""

    def open(self) -> None:
        """Begin to send."""

    def flush(self, timeout: float) -> None:
        """Wait, at most ``timeout`` s, until all that was sent has arrived. Raises what Rerun raises."""

    def disconnect(self) -> None:
        """End the stream."""

    def close(self) -> None:
        """Release what else is held; may be called again."""


def destination(parameters: Parameters) -> Destination:
    """The destination of a live run that ``rerun.mode`` names. Raises UsageError if it can't be used."""
    mode = parameters.rerun.mode
    if mode == "save":
        path = Path(parameters.rerun.path)
        _require_new_files(path)
        return FileDestination(parameters, path, path)
    if mode == "serve":
        return ServerDestination(parameters, "operator", Density(math.inf), LIVE_MEMORY)
    if mode == "connect":
        return ViewerDestination(parameters)
    raise UsageError(f"rerun.mode {mode!r} shows nothing: use save, serve, connect")


class _Stream:
    """A Rerun stream and what is drawn into it."""

    send_interval = LIVE_SEND_INTERVAL

    def __init__(self, parameters: Parameters, density: Density) -> None:
        self.stream = rr.RecordingStream(APPLICATION)
        self.display = RunDisplay(self.stream, parameters, density)

    def ready(self) -> bool:
        return True

    def begin(
        self, sink: rr.FileSink | rr.GrpcServerSink | rr.GrpcSink, layout: str, playback: blueprint.Playback
    ) -> None:
        """Send to ``sink``, which opens with ``layout`` of LAYOUTS."""
        opening = blueprint.LAYOUTS[layout](self.display.views(), playback)
        self.stream.set_sinks(sink, default_blueprint=opening)
        self.display.draw_fixed()
        self.display.canvas.send()

    def flush(self, timeout: float) -> None:
        self.stream.flush(timeout_sec=timeout)

    def disconnect(self) -> None:
        self.stream.disconnect()

    def close(self) -> None:
        """Nothing else is held."""


class FileDestination(_Stream):
    """A new .rrd file, with its layouts as .rbl files beside it."""

    send_interval = FILE_SEND_INTERVAL

    def __init__(self, parameters: Parameters, path: Path, named: Path) -> None:
        """Write to ``path``, which the caller renames to ``named`` at the end if they differ."""
        super().__init__(parameters, Density(FULL_SPAN))
        self.address = str(named)
        self._path = path
        self._named = named

    def open(self) -> None:
        self.begin(rr.FileSink(self._path), OVERVIEW, blueprint.SLOW_MOTION)
        for layout, path in layout_files(self._named):
            playback = blueprint.SLOW_MOTION if layout == OVERVIEW else blueprint.LIVE
            blueprint.LAYOUTS[layout](self.display.views(), playback).save(APPLICATION, path)


class ServerDestination(_Stream):
    """A server on the loopback interface for viewers, and a page for browsers."""

    def __init__(self, parameters: Parameters, layout: str, density: Density, memory: str) -> None:
        """``layout`` is that with which viewers open, one of LAYOUTS; ``memory`` is what the server keeps.

        Raises UsageError if a port is taken; Rerun would drop the data.
        """
        super().__init__(parameters, density)
        self._layout = layout
        self._memory = memory
        self._port, self._web_port = parameters.rerun.port, parameters.rerun.web_port
        _require_free(self._port, "rerun.port")
        url = f"rerun+http://{SERVER_ADDRESS}:{self._port}/proxy"
        self.address = url
        self._page: subprocess.Popen[bytes] | None = None
        if self._web_port:
            _require_free(self._web_port, "rerun.web_port")
            self.address = f"http://{SERVER_ADDRESS}:{self._web_port}/?url={quote(url, safe='')}"
            self._page = start_child(web_page_command(self._web_port, url))

    def open(self) -> None:
        sink = rr.GrpcServerSink(SERVER_ADDRESS, self._port, server_memory_limit=self._memory)
        self.begin(sink, self._layout, blueprint.SLOW_MOTION if self._layout == OVERVIEW else blueprint.LIVE)

    def close(self) -> None:
        if self._page is not None:
            self._page.terminate()
            self._page.wait(STOP_TIMEOUT)
            self._page = None


def server_of_recording(parameters: Parameters) -> ServerDestination:
    """A server that shows a run that has ended, from its first sample on.

    Raises UsageError as ServerDestination does.
    """
    return ServerDestination(parameters, OVERVIEW, Density(FULL_SPAN), RECORDED_MEMORY)


class ViewerDestination(_Stream):
    """A viewer that listens at ``rerun.url``."""

    def __init__(self, parameters: Parameters) -> None:
        """Raises UsageError if the URL has no host and port."""
        super().__init__(parameters, Density(math.inf))
        self.address = parameters.rerun.url
        self._place = viewer_address(self.address)
        self._sink = rr.GrpcSink(self.address)

    def ready(self) -> bool:
        return is_listening(*self._place)

    def open(self) -> None:
        self.begin(self._sink, "operator", blueprint.LIVE)


def layout_files(path: Path) -> Iterator[tuple[str, Path]]:
    """Names of the layouts, and their files beside the .rrd file ``path``."""
    for name in blueprint.LAYOUTS:
        yield name, path.with_name(f"{path.name.removesuffix('.rrd')}.{name}.rbl")


def web_page_command(port: int, url: str) -> list[str]:
    """Command that hosts Rerun's page on the loopback interface; the page shows ``url``.

    Rerun's own function listens on all interfaces.
    """
    found = importlib.util.find_spec("rerun_cli")
    folder = Path(found.origin).parent if found is not None and found.origin else Path()
    return [
        str(folder / "rerun"),
        "--serve-web",
        "--bind",
        SERVER_ADDRESS,
        "--web-viewer-port",
        str(port),
        url,
    ]


def _require_new_files(path: Path) -> None:
    for target in (path, *(beside for _, beside in layout_files(path))):
        if target.exists():
            raise UsageError(f"rerun.path {path}: {target} exists already: name a new file or remove it")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"rerun.path {path}: its folder can't be made: {error.strerror}") from error
    if not os.access(path.parent, os.W_OK):
        raise UsageError(f"rerun.path {path}: its folder is not writable: name another")


def _require_free(port: int, name: str) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((SERVER_ADDRESS, port))
        except OSError as error:
            raise UsageError(
                f"{name} {port} can't be used ({error.strerror}): stop the program that uses it, "
                "or choose another port"
            ) from error


def viewer_address(url: str) -> tuple[str, int]:
    """Host and port of a viewer's URL such as rerun+http://127.0.0.1:9876/proxy.

    Raises UsageError if the URL has none.
    """
    try:
        parts = urlsplit(url)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port = None, None
    if host is None or port is None:
        raise UsageError(
            f"rerun.url {url!r} is not the address of a viewer: write rerun+http://HOST:PORT/proxy"
        )
    return host, port


def is_listening(host: str, port: int) -> bool:
    """Whether a server listens there; without one, a Rerun sink blocks for seconds and piles up data."""
    try:
        with socket.create_connection((host, port), timeout=PROBE_TIMEOUT):
            return True
    except OSError:
        return False
