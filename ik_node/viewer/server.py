"""The viser server of a page, which answers its own page only.

Every page that a browser shows may connect to a server on this computer. The browser names the page's address in the
header Origin, and the address that it believes to speak to in the header Host; requests with others are refused.
"""

from __future__ import annotations

import contextlib
import http
import io
import ipaddress
import socket
import threading
from collections.abc import Iterator
from typing import Any
from urllib.parse import urlsplit

from ik_node.errors import IkNodeError, MissingPackageError

LOCAL = "127.0.0.1"
"""Accepts connections from this computer only."""
_starting = threading.Lock()


def serve(port: int, host: str = LOCAL) -> Any:
    """Starts a viser server that refuses pages of other origins.

    Args:
        port: Port of the page; the next free one if it is in use, any free one for 0.
        host: Network interface.

    Returns:
        viser.ViserServer.

    Raises:
        MissingPackageError: viser is not installed.
        IkNodeError: The installed viser cannot be made to refuse other origins.
    """
    try:
        import viser
    except ImportError as error:
        raise MissingPackageError(error) from error
    # The command line prints the address; the server's own output is suppressed.
    with contextlib.redirect_stdout(io.StringIO()), _own_origin_only(host) as checked:
        server = viser.ViserServer(host=host, port=port, label="ik_view", verbose=False)
    if not checked:
        server.stop()
        raise IkNodeError(f"viser {viser.__version__} cannot be made to refuse pages of other origins; valid: 1.x")
    return server


def url_of(server: Any) -> str:
    """Address of the page."""
    host = server.get_host()
    return f"http://{'localhost' if host in ('0.0.0.0', LOCAL) else host}:{server.get_port()}"


def is_own_origin(interface: str, hosts: list[str], origins: list[str]) -> bool:
    """Whether a request comes from a page of the server itself, or from no page.

    Names are compared, not ports, with the interface: a tunnel may have another port. On other interfaces than
    :data:`LOCAL` every address is accepted as Host, but of names only those of this computer: the name of a foreign
    page may be made to resolve to any address.

    Args:
        interface: Network interface of the server.
        hosts: Values of the header Host.
        origins: Values of the header Origin; none for programs other than browsers.
    """
    if len(hosts) != 1 or len(origins) > 1:
        return False
    try:
        name = urlsplit(f"//{hosts[0]}").hostname or ""
        same = all(urlsplit(origin).netloc.lower() == hosts[0].lower() for origin in origins)
    except ValueError:
        return False
    return same and _is_own_name(interface, name)


def _is_own_name(interface: str, name: str) -> bool:
    if name == "localhost":
        return True
    try:
        address = ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return interface != LOCAL and name in (interface.lower(), own, f"{own}.local", own.partition(".")[0])
    return interface != LOCAL or address.is_loopback


@contextlib.contextmanager
def _own_origin_only(interface: str) -> Iterator[list[bool]]:
    """Adds the check to the server that starts meanwhile; the list has an entry when it was added.

    viser passes no such option to websockets, so its function is replaced while the server starts.
    """
    from websockets.asyncio import server as websockets

    checked: list[bool] = []
    original: Any = websockets.serve

    def guarded(*arguments: Any, process_request: Any = None, **options: Any) -> Any:
        def checked_request(connection: Any, request: Any) -> Any:
            headers = request.headers
            if not is_own_origin(interface, headers.get_all("Host"), headers.get_all("Origin")):
                return connection.respond(http.HTTPStatus.FORBIDDEN, "This page answers its own origin only.\n")
            return process_request(connection, request) if process_request is not None else None

        checked.append(True)
        return original(*arguments, process_request=checked_request, **options)

    with _starting:
        websockets.serve = guarded  # type: ignore[assignment,misc]
        try:
            yield checked
        finally:
            websockets.serve = original  # type: ignore[misc]
