"""The server of the viewer answers requests of its own origin only."""

from __future__ import annotations

import http.client
from typing import Any

import pytest
from waiting import ENOUGH_S

viser = pytest.importorskip("viser")
from websockets.exceptions import InvalidStatus  # noqa: E402
from websockets.sync.client import connect  # noqa: E402
from websockets.typing import Origin, Subprotocol  # noqa: E402

from ik_node.viewer.server import is_own_origin, serve  # noqa: E402


def status(port: int, host: str, origin: str = "") -> int:
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=ENOUGH_S)
    connection.request("GET", "/", headers={"Host": host, **({"Origin": origin} if origin else {})})
    return connection.getresponse().status


def test_other_origins_and_hosts_are_refused() -> None:
    server = serve(0)
    try:
        port = server.get_port()
        assert status(port, f"localhost:{port}") == 200
        assert status(port, "evil.example") == 403
        assert status(port, f"localhost:{port}", "http://evil.example") == 403
        options: dict[str, Any] = {
            "subprotocols": [Subprotocol(f"viser-v{viser.__version__}")],
            "open_timeout": ENOUGH_S,
        }
        with connect(f"ws://127.0.0.1:{port}", origin=Origin(f"http://127.0.0.1:{port}"), **options) as own:
            assert own.recv(ENOUGH_S)
        for origin in ("http://evil.example", "null", f"http://localhost:{port + 1}"):
            with pytest.raises(InvalidStatus, match="403"):
                connect(f"ws://127.0.0.1:{port}", origin=Origin(origin), **options)
    finally:
        server.stop()


@pytest.mark.parametrize(
    ("interface", "hosts", "origins", "own"),
    [
        ("127.0.0.1", ["localhost:8080"], [], True),
        ("127.0.0.1", ["[::1]:8080"], ["http://[::1]:8080"], True),
        ("127.0.0.1", ["192.168.0.2"], [], False),
        ("127.0.0.1", ["localhost", "localhost"], [], False),
        ("127.0.0.1", [], [], False),
        ("127.0.0.1", ["[::1"], [], False),
        ("0.0.0.0", ["192.168.0.2:8080"], ["http://192.168.0.2:8080"], True),
        ("0.0.0.0", ["evil.example"], ["http://evil.example"], False),
        ("robot.local", ["robot.local:80"], [], True),
    ],
)
def test_own_names(interface: str, hosts: list[str], origins: list[str], own: bool) -> None:
    assert is_own_origin(interface, hosts, origins) is own
