"""The viser server behind a page."""

from __future__ import annotations

import contextlib
import io
from typing import Any

from ik_node.errors import IkNodeError

LOCAL = "127.0.0.1"
"""Only programs on this computer can reach the page."""


def serve(port: int, host: str = LOCAL) -> Any:
    """A viser server on ``port``, or on the next free one; 0: any. IkNodeError when viser is not installed."""
    try:
        import viser
    except ImportError as error:
        raise IkNodeError("the page needs viser, which is not installed: pip install viser") from error
    # It would print a box of its own; the command line says where the page is.
    with contextlib.redirect_stdout(io.StringIO()):
        return viser.ViserServer(host=host, port=port, label="ik_view", verbose=False)


def url_of(server: Any) -> str:
    """Where the page is."""
    host = server.get_host()
    return f"http://{'localhost' if host in ('0.0.0.0', LOCAL) else host}:{server.get_port()}"
