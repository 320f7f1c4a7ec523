"""Where the viewer's data goes: a file, a server on this machine, or a running viewer elsewhere."""

from __future__ import annotations

import os
import socket
from pathlib import Path
from urllib.parse import urlsplit

import rerun as rr

from gear_dynamics_ros.errors import UsageError

SERVER_ADDRESS = "127.0.0.1"
SERVER_MEMORY = "256MiB"
PROBE_TIMEOUT = 0.5  # s of wall time


def file_sink(path: str) -> rr.FileSink:
    """Sink into the new file ``path``. Raises UsageError if it exists or can't be made."""
    target = Path(path)
    if target.exists():
        raise UsageError(f"rerun.path {path} exists already: name a new file or remove it")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"rerun.path {path}: its folder can't be made: {error.strerror}") from error
    if not os.access(target.parent, os.W_OK):
        raise UsageError(f"rerun.path {path}: its folder is not writable: name another")
    return rr.FileSink(target)


def server_sink(port: int) -> rr.GrpcServerSink:
    """Server on the loopback interface. Raises UsageError if the port is taken; Rerun would drop the data."""
    with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((SERVER_ADDRESS, port))
        except OSError as error:
            raise UsageError(
                f"rerun.port {port} can't be used ({error.strerror}): stop the program that uses it, "
                "or choose another port"
            ) from error
    return rr.GrpcServerSink(SERVER_ADDRESS, port, server_memory_limit=SERVER_MEMORY)


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
