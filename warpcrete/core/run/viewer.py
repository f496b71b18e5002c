"""Rerun's viewer, on this screen or in a browser; by default, only this machine can connect to it."""

import ipaddress
import os
import socket
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import rerun_cli  # pyright: ignore[reportMissingTypeStubs]

from ..errors import RunFolderError, refuse
from .processes import killed_with_parent

LOOPBACK = "127.0.0.1"
WEB_PORT, DATA_PORT = 9090, 9876
"""Preferred network ports of the viewer: for its web page, and for the recording's data.

Other ports are used if these ports are occupied."""
MAGIC = b"RRF"
"""First bytes of Rerun's recordings."""
START_TIMEOUT = 20.0
"""Longest time to wait until a server accepts connections [s]."""


def rerun_tool() -> str:
    """Return the path of Rerun's executable."""
    return str(Path(rerun_cli.__file__).with_name("rerun.exe" if sys.platform == "win32" else "rerun"))


@dataclass(frozen=True)
class Viewer:
    """Viewer that can be started, with its command and the sockets on which it listens."""

    command: list[str]
    address: str
    """URL that a browser opens, or to which a run sends its recording."""
    endpoints: tuple[tuple[str, int], ...] = field(default=())
    """Host and port of each socket on which the viewer listens."""
    in_browser: bool = False
    """True if a browser shows the recording, at `address`; False for a window."""

    def start(self) -> subprocess.Popen[bytes]:
        """Start the viewer, and wait until it accepts connections; return its process.

        The viewer prints nothing, unless the user's variable RUST_LOG sets the level of its log. Raises
        :class:`RunFolderError` if the viewer does not start.
        """
        process = subprocess.Popen(
            self.command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL,
            stderr=None if "RUST_LOG" in os.environ else subprocess.DEVNULL, env={"RUST_LOG": "off", **os.environ},
        )  # fmt: skip
        end = time.monotonic() + START_TIMEOUT
        while not all(map(_accepts_connections, self.endpoints)):
            if process.poll() is not None or time.monotonic() > end:
                process.kill()
                raise RunFolderError(
                    f"the Rerun viewer did not start at {self.address}; set RUST_LOG=info to see why, or try "
                    f"'{' '.join(self.command)}'"
                )
            time.sleep(0.05)
        return process


def is_recording(path: Path) -> bool:
    """Return whether a file begins like a recording of Rerun, which an empty or damaged file does not."""
    with path.open("rb") as file:
        return file.read(len(MAGIC)) == MAGIC


def web_viewer(recordings: Sequence[Path], bind: str = LOOPBACK) -> Viewer:
    """Return a viewer that serves the `recordings` and a web page that shows them; it ends with this process.

    The server listens on the IP address `bind`.
    """
    web, data = _free_port(bind, WEB_PORT), _free_port(bind, DATA_PORT)
    host = _host(bind)
    source = urllib.parse.quote(f"rerun+http://{host}:{data}/proxy", safe="")
    command = [rerun_tool(), *map(str, recordings), "--serve-web", *_ports(bind, data), "--web-viewer-port", str(web)]
    address = f"http://{host}:{web}?url={source}"
    return Viewer(killed_with_parent(command), address, ((bind, web), (bind, data)), True)


def screen_viewer(recordings: Sequence[Path] = (), bind: str = LOOPBACK) -> Viewer:
    """Return a viewer that opens a window for the `recordings`.

    The viewer also receives data from runs, over a socket on the IP address `bind`. Its window stays open after this
    process ends.
    """
    data = _free_port(bind, DATA_PORT)
    command = [rerun_tool(), *map(str, recordings), *_ports(bind, data), "--expect-data-soon"]
    return Viewer(command, f"rerun+http://{_host(bind)}:{data}/proxy", ((bind, data),))


def has_screen() -> bool:
    """Return whether this machine can open a window."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def _ports(bind: str, data: int) -> list[str]:
    return ["--bind", bind, "--port", str(data)]


def _host(bind: str) -> str:
    """Return the host name for URLs with which browsers and other machines reach a socket at the IP address `bind`."""
    address = ipaddress.ip_address(bind)
    if address.is_unspecified:
        return socket.gethostname()
    return f"[{bind}]" if address.version == 6 else bind


def _family(bind: str) -> socket.AddressFamily:
    try:
        return socket.AF_INET6 if ipaddress.ip_address(bind).version == 6 else socket.AF_INET
    except ValueError:
        refuse(
            "bind", bind, "must be an IP address of this machine", f"use {LOOPBACK} for access from this machine only"
        )


def _free_port(bind: str, wanted: int) -> int:
    """Return the `wanted` port if it is free at the IP address `bind`, else another free port."""
    family = _family(bind)
    for port in (wanted, 0):
        with socket.socket(family) as probe:
            try:
                probe.bind((bind, port))
                return probe.getsockname()[1]
            except OSError as error:
                if not port:
                    refuse("bind", bind, f"is not an address of this machine ({error.strerror})", f"use {LOOPBACK}")
    raise AssertionError


def _accepts_connections(place: tuple[str, int]) -> bool:
    host, port = place
    if ipaddress.ip_address(host).is_unspecified:
        host = "::1" if ":" in host else LOOPBACK
    try:
        socket.create_connection((host, port), 0.2).close()
    except OSError:
        return False
    return True
