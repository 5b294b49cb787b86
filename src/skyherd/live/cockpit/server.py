"""Server of the page: the page itself, its state as JSON, pictures, and the request to stop.

Requests run in threads of their own. The only effect that one can have is `stop_asked`.
"""

import json
import secrets
from collections.abc import Mapping
from dataclasses import dataclass
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from socket import socket
from threading import Event, Thread
from typing import Any
from urllib.parse import urlsplit

from skyherd.live.cockpit.previews import picture_path
from skyherd.report.access import Access, bind

WAIT_S = 5.0
"""Longest wait for a browser, s. Chosen: a slow one is dropped, and asks again."""

CLOSE_S = 0.05
"""Longest delay of the server's end, s. Chosen: twenty checks a second cost nothing."""

HEADERS = {"Cache-Control": "no-store", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
"""Headers of every answer."""


@dataclass(frozen=True)
class PageAddress:
    """Address at which a page is served; port 0 is any free one."""

    host: str
    port: int


class Server:
    """Server of one page.

    Attributes:
        access: rules for the requests, with the address to open.

    Args:
        address: where it listens.
        previews: folder of the units' pictures.
        units: number of units.
        title: title of the page.

    Raises:
        InputError: the address is not one of this computer, or its port is in use.
    """

    def __init__(self, address: PageAddress, previews: Path, units: int, title: str) -> None:
        # Imported here, since it loads Matplotlib, which units do not need.
        from skyherd.report.pages import render_page

        listener = bind(address.host, address.port)
        self.access = Access.make(address.host, listener.getsockname()[1])
        self._stop, self._state = Event(), b"{}"
        self._previews, self._units = previews, units
        self._nonce = secrets.token_urlsafe(16)
        self._html = render_page(
            "skyherd.live.cockpit", "cockpit.html", title=title, nonce=self._nonce
        ).encode()
        self._http = _Http(listener, self)
        self._thread = Thread(target=self._http.serve_forever, args=(CLOSE_S,), name="page", daemon=True)
        self._thread.start()

    def publish(self, state: Mapping[str, Any]) -> None:
        """Set the state that browsers get."""
        self._state = json.dumps(state).encode()

    def stop_asked(self) -> bool:
        """Return whether a browser asked to stop since the last call."""
        asked = self._stop.is_set()
        self._stop.clear()
        return asked

    def close(self) -> None:
        """Close the page."""
        self._http.shutdown()
        self._http.server_close()
        self._thread.join()

    def answer(self, path: str) -> tuple[HTTPStatus, str, bytes]:
        """Return status, content type and body of a page, for a request that is allowed."""
        if path == "/":
            return HTTPStatus.OK, "text/html; charset=utf-8", self._html
        if path == "/state":
            return HTTPStatus.OK, "application/json", self._state
        for unit in range(self._units):
            if path == f"/unit/{unit}.jpg":
                try:
                    return HTTPStatus.OK, "image/jpeg", picture_path(self._previews, unit).read_bytes()
                except OSError:
                    break
        return HTTPStatus.NOT_FOUND, "text/plain", b"no such page"

    def policy(self) -> str:
        """Return the content security policy: nothing from elsewhere, and no script but the page's own."""
        return (
            f"default-src 'none'; script-src 'nonce-{self._nonce}'; style-src 'unsafe-inline'; "
            "img-src 'self' data:; connect-src 'self'; frame-ancestors 'none'"
        )

    def ask_stop(self) -> None:
        """Ask to stop, for a request that is allowed."""
        self._stop.set()


class _Http(ThreadingHTTPServer):
    """HTTP server on a socket that listens already."""

    daemon_threads = True

    def __init__(self, listener: socket, page: Server) -> None:
        super().__init__(listener.getsockname()[:2], _Handler, bind_and_activate=False)
        self.socket.close()
        self.socket, self.page = listener, page

    def handle_error(self, request: object, client_address: object) -> None:
        """Ignore a browser that is gone or sends nonsense."""


class _Handler(BaseHTTPRequestHandler):
    """Answers to one browser."""

    server: _Http
    timeout = WAIT_S
    server_version, sys_version = "skyherd", ""

    def do_GET(self) -> None:
        """Answer a request for a page; one with the token in its address gets the cookie."""
        page, parts = self.server.page, urlsplit(self.path)
        if page.access.has_token(self.path, self.headers.get("Host", "")):
            cookie = f"{page.access.cookie}={page.access.token}; HttpOnly; SameSite=Strict; Path=/"
            self._send(HTTPStatus.SEE_OTHER, "text/plain", b"", {"Location": "/", "Set-Cookie": cookie})
        elif not self._refused(is_act=False):
            self._send(*page.answer(parts.path))

    def do_POST(self) -> None:
        """Ask to stop, if the request is from the page itself."""
        if self._refused(is_act=True):
            return
        if self.path != "/stop":
            self._send(HTTPStatus.NOT_FOUND, "text/plain", b"no such page")
            return
        self.server.page.ask_stop()
        self._send(HTTPStatus.ACCEPTED, "text/plain", b"asked")

    def log_message(self, format: str, *args: object) -> None:
        """Log nothing."""

    def _refused(self, *, is_act: bool) -> bool:
        """Refuse a request that is not from a browser with the token; return whether it is refused."""
        headers = {name: self.headers.get(name, "") for name in ("Host", "Origin", "Cookie")}
        reason = self.server.page.access.refusal(headers, is_socket=is_act)
        if reason is not None:
            self._send(HTTPStatus.FORBIDDEN, "text/plain", f"refused: {reason}".encode())
        return reason is not None

    def _send(
        self, status: HTTPStatus, kind: str, body: bytes, more: Mapping[str, str] | None = None
    ) -> None:
        self.send_response(status)
        headers = {**HEADERS, "Content-Security-Policy": self.server.page.policy(), **(more or {})}
        for name, value in {**headers, "Content-Type": kind, "Content-Length": str(len(body))}.items():
            self.send_header(name, value)
        self.end_headers()
        self.wfile.write(body)
