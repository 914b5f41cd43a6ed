"""The page's server: on this machine alone, unless told otherwise; then behind a token, and never for foreign pages."""

import http
import ipaddress
import logging
import secrets
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout
from io import StringIO
from typing import Any
from urllib.parse import parse_qs, urlsplit

import viser
import websockets.asyncio.server
from websockets.asyncio.server import ServerConnection
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from torchid.errors import ConfigError

LOOPBACK = "127.0.0.1"
PORT = 8080
"""Choice. First port that is tried; the next free one is taken."""
TRIED, LAST_PORT = 100, 65535
"""Choice. Ports that are tried."""
LARGEST = 1 << 20
"""Choice. Bytes of a message from a browser: camera, clicks and sliders need less than a thousandth."""
COOKIE = "torchid_token"
_patching = threading.Lock()


def open_page(port: int = PORT, host: str = LOOPBACK, token: str | None = None) -> tuple[viser.ViserServer, str]:
    """Start a server and return it with the address to open.

    Foreign pages are refused by ``Origin``, and foreign names of this machine by ``Host`` (DNS rebinding); what is open
    to other machines needs a token, which the address carries and a cookie keeps.

    Args:
        port: first one to try.
        host: address to bind; every machine that reaches it can open the page if it knows the token.
        token: for other addresses than the loopback; drawn where None.

    Raises:
        ConfigError: ``scene.host``, the address is none of this machine's, or no port near the first is free.
    """
    port = _free_port(host, port)
    logging.getLogger("websockets.server").setLevel(logging.CRITICAL)  # a traceback for every stray byte
    guard = Guard(None if _loops(host) else token or secrets.token_urlsafe(16))
    with _guarded(guard), redirect_stdout(StringIO()):  # it greets, whatever ``verbose`` says
        server = viser.ViserServer(host=host, port=port, verbose=False)
    server.gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
    server.gui.main_panel.dock_right()
    name = {"0.0.0.0": LOOPBACK, "::": "::1"}.get(host, host)  # noqa: S104 - what to open where all are bound
    address = f"http://{f'[{name}]' if ':' in name else name}:{server.get_port()}"
    return server, address if guard.token is None else f"{address}/?token={guard.token}"


def close_page(server: viser.ViserServer) -> None:
    """Stop a server."""
    with redirect_stdout(StringIO()):
        server.stop()


class Guard:
    """Says which requests a page answers."""

    def __init__(self, token: str | None) -> None:
        """Answer this machine's own pages alone, or with a token anybody's who knows it.

        Args:
            token: that every request has to show.
        """
        self.token = token

    def __call__(self, request: Request) -> Response | None:
        """Return the refusal of a request; None where it is welcome."""
        hosts, origins = request.headers.get_all("Host"), request.headers.get_all("Origin")
        if len(hosts) != 1 or len(origins) > 1:
            return _answer(http.HTTPStatus.BAD_REQUEST, "one host, and one page")
        host, origin = hosts[0], origins[0] if origins else None
        if self.token is None and not _loops(urlsplit(f"//{host}").hostname or ""):
            return _answer(http.HTTPStatus.FORBIDDEN, "this page is open at its own address alone")
        if origin is not None and urlsplit(origin).netloc != host:
            return _answer(http.HTTPStatus.FORBIDDEN, "this page is not for other pages")
        if self.token is None:
            return None
        given = parse_qs(urlsplit(request.path).query).get("token", [""])[0]
        if given and secrets.compare_digest(given.encode(), self.token.encode()):
            answer = _answer(http.HTTPStatus.FOUND, "")
            answer.headers["Location"] = "/"
            answer.headers["Set-Cookie"] = f"{COOKIE}={self.token}; HttpOnly; SameSite=Lax; Path=/"
            return answer
        # By hand: other services of this host set cookies too, and not all that ``http.cookies`` can read.
        kept = "; ".join(request.headers.get_all("Cookie")).split("; ")
        if any(secrets.compare_digest(one.encode(), f"{COOKIE}={self.token}".encode()) for one in kept):
            return None
        return _answer(http.HTTPStatus.FORBIDDEN, "this page is open with its token alone")


@contextmanager
def _guarded(guard: Guard) -> Iterator[None]:
    """viser servers that are made here ask a guard first: it leaves no other way to its socket (viser 1.1)."""
    original = websockets.asyncio.server.serve

    def serve(*arguments: Any, **options: Any) -> Any:
        inner: Callable[[ServerConnection, Request], Response | None] = options["process_request"]
        options["process_request"] = lambda connection, request: guard(request) or inner(connection, request)
        return original(*arguments, **options | {"max_size": LARGEST})

    with _patching:
        websockets.asyncio.server.serve = serve  # type: ignore[misc, assignment]
        try:
            yield
        finally:
            websockets.asyncio.server.serve = original


def _loops(host: str) -> bool:
    try:
        return host == "localhost" or ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def _answer(status: http.HTTPStatus, text: str) -> Response:
    body = text.encode()
    headers = Headers({"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))})
    return Response(status.value, status.phrase, headers, body)


def _free_port(host: str, first: int) -> int:
    """The first port that can be bound, looked for here: viser would look for ever."""
    family, reason = socket.AF_INET6 if ":" in host else socket.AF_INET, ""
    for port in range(first, min(first + TRIED, LAST_PORT) + 1):
        try:
            socket.create_server((host, port), family=family).close()
        except OSError as error:
            reason = error.strerror or str(error)
            continue
        return port
    raise ConfigError(
        "scene.host", f"no page can be opened here: {reason}", place="--host, --port", found=f"{host[:80]}, {first}",
        remedy="Give an address of this machine, or leave --host out; else another port",
    )  # fmt: skip
