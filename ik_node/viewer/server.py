"""The viser server of a page."""

from __future__ import annotations

import contextlib
import io
from typing import Any

from ik_node.errors import MissingPackageError

LOCAL = "127.0.0.1"
"""Accepts connections from this computer only."""


def serve(port: int, host: str = LOCAL) -> Any:
    """Starts a viser server.

    Args:
        port: Port of the page; the next free one if it is in use, any free one for 0.
        host: Network interface.

    Returns:
        viser.ViserServer.

    Raises:
        MissingPackageError: viser is not installed.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingPackageError(error) from error
    # The command line prints the address; the server's own output is suppressed.
    with contextlib.redirect_stdout(io.StringIO()):
        return viser.ViserServer(host=host, port=port, label="ik_view", verbose=False)


def url_of(server: Any) -> str:
    """Address of the page."""
    host = server.get_host()
    return f"http://{'localhost' if host in ('0.0.0.0', LOCAL) else host}:{server.get_port()}"
