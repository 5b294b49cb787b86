"""viser's server behind the checks of `access` and `messages`, on a socket that is already bound."""

import io
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager, redirect_stdout, suppress
from http import HTTPStatus
from socket import socket
from typing import Any

import viser
import websockets.asyncio.server as web
from viser._messages import SetCameraLookAtMessage, SetCameraPositionMessage
from websockets.datastructures import Headers
from websockets.http11 import Request, Response

from skyherd.play.messages import MAX_BYTES, MessageFilter
from skyherd.play.page_style import add_style
from skyherd.play.poses import Place
from skyherd.report.access import Access

MAX_REFUSED = 20
"""Refused messages after which a connection is closed. Chosen: the page sends none."""

POLICY_VIOLATION = 1008
"""Code of a connection that is closed for its messages. Defined by RFC 6455."""

STOP_S = 5.0
"""Time in which the server may wind down, s. Chosen: ten times as long as it takes."""

READ_HEADERS = ("Host", "Origin", "Cookie", "Upgrade", "Sec-WebSocket-Protocol")
"""Headers of requests that are read. Values of a repeated header are joined: only cookies may repeat."""

SAFE_HEADERS = {
    "Cache-Control": "no-store",
    "Content-Security-Policy": "frame-ancestors 'none'",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
}
"""Headers of every answer. Other pages can neither embed nor read this one, nor get its token."""


def start_server(access: Access, listener: socket, allowed: MessageFilter) -> viser.ViserServer:
    """Start viser's server behind the checks.

    Args:
        access: rules for requests.
        listener: the bound socket.
        allowed: filter of the browsers' messages.
    """
    with _guarded(access, listener, allowed), redirect_stdout(io.StringIO()):
        server = viser.ViserServer(host=access.host, port=access.port, label="skyherd", verbose=False)
    # The relay makes a page public. Without the button and the handler nothing asks for it.
    server.gui.configure_theme(show_share_button=False, show_logo=False)
    add_style(server)
    return server


def stop_server(server: viser.ViserServer) -> None:
    """Close all connections and stop the server, without its farewell on stdout."""
    with redirect_stdout(io.StringIO()):
        server._websock_server.disconnect_all_clients()
        server.stop()
        if server._websock_server._server_thread is not None:
            server._websock_server._server_thread.join(STOP_S)


def set_first_view(client: viser.ClientHandle, place: Place, looked_at: Place) -> None:
    """Set the view that a browser begins with, and returns to by its command *Reset View*.

    viser's `initial_camera` is the same for all windows, and is applied after values of `client.camera`. A
    browser that has closed the page meanwhile gets nothing.

    Args:
        client: the browser.
        place: place of the observer, m.
        looked_at: point in the middle of the window, m.
    """
    with client.atomic():
        send = client._websock_connection.queue_message
        with suppress(UserWarning), warnings.catch_warnings():
            warnings.filterwarnings("error", "Queued a .* on a closed connection", UserWarning)
            send(SetCameraPositionMessage(place, initial=True))
            send(SetCameraLookAtMessage(looked_at, initial=True))


@contextmanager
def _guarded(access: Access, listener: socket, allowed: MessageFilter) -> Iterator[None]:
    """Let viser serve at a bound socket, behind the checks; it has no option for either."""
    serve = web.serve

    def guarded(handler: Callable[[Any], Any], host: str, port: int, **options: Any) -> Any:
        answer = options.pop("process_request")
        options |= {"max_size": MAX_BYTES, "sock": listener, "process_request": _checked(access, answer)}
        return serve(lambda connection: handler(_FilteredConnection(connection, allowed)), **options)

    web.serve = guarded  # type: ignore[assignment, misc]
    try:
        yield
    finally:
        web.serve = serve  # type: ignore[misc]


def _checked(access: Access, answer: Callable[[Any, Request], Response | None]) -> Any:
    """Return a function that answers requests with `answer` if the rules allow them."""

    def process(connection: Any, request: Request) -> Response | None:
        headers = {name: "; ".join(request.headers.get_all(name)) for name in READ_HEADERS}
        is_socket = headers["Upgrade"].lower() == "websocket"
        if not is_socket and access.has_token(request.path, headers["Host"]):
            return _with_cookie(access)
        reason = access.refusal(headers, is_socket=is_socket)
        if reason is None and is_socket and not _is_of_this_version(headers):
            reason = "page of another version; reload it"
        if reason is not None:
            return _response(HTTPStatus.FORBIDDEN, f"refused: {reason}\n")
        response = answer(connection, request)
        if response is not None:
            for name, value in SAFE_HEADERS.items():
                response.headers[name] = value
        return response

    return process


def _is_of_this_version(headers: dict[str, str]) -> bool:
    offered = headers["Sec-WebSocket-Protocol"].split(",")
    return f"viser-v{viser.__version__}" in [name.strip() for name in offered]


def _with_cookie(access: Access) -> Response:
    """Return the answer to a request with the token: a cookie, and the address without the token."""
    cookie = f"{access.cookie}={access.token}; HttpOnly; SameSite=Strict; Path=/"
    return _response(HTTPStatus.SEE_OTHER, "", {"Set-Cookie": cookie, "Location": "/"})


def _response(status: HTTPStatus, text: str, more: dict[str, str] | None = None) -> Response:
    body = text.encode()
    headers = {"Content-Type": "text/plain; charset=utf-8", "Content-Length": str(len(body))}
    return Response(status, status.phrase, Headers(headers | SAFE_HEADERS | (more or {})), body)


class _FilteredConnection:
    """A connection that passes on only messages which the filter accepts."""

    def __init__(self, connection: Any, allowed: MessageFilter) -> None:
        self._connection, self._allowed = connection, allowed
        self._refused = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self._connection, name)

    async def recv(self) -> bytes:
        """Return the next accepted message; close the connection after too many others."""
        while True:
            raw = await self._connection.recv()
            if self._allowed.accepts(raw):
                return bytes(raw)
            self._refused += 1
            if self._refused >= MAX_REFUSED:
                await self._connection.close(POLICY_VIOLATION, "too many invalid messages")
