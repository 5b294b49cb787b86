"""Access to a page that a running program serves: who may connect.

- A request names the server by an allowed host, so that a foreign name that resolves to this computer (DNS
  rebinding) is refused.
- The first request carries the token of this session in its address. The answer sets a cookie, which later
  requests and the WebSocket must carry.
- A WebSocket comes from the page itself, by its header `Origin`.
"""

import ipaddress
import secrets
import socket
from collections.abc import Mapping
from dataclasses import dataclass
from hmac import compare_digest
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

from skyherd.errors import InputError

TOKEN_BYTES = 24
"""Random bytes of a token. Chosen: cannot be guessed."""

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
"""Names of this computer that a browser may use."""


@dataclass(frozen=True)
class Access:
    """Rules for the requests to one server.

    Attributes:
        host: address that the server listens at.
        port: its port.
        token: secret of this session.
    """

    host: str
    port: int
    token: str

    @classmethod
    def make(cls, host: str, port: int) -> "Access":
        """Make the rules of a server, with a new token."""
        return cls(host, port, secrets.token_urlsafe(TOKEN_BYTES))

    @property
    def url(self) -> str:
        """Address to open in a browser."""
        host = "127.0.0.1" if self.host in ("0.0.0.0", "::") else self.host
        return f"http://{f'[{host}]' if ':' in host else host}:{self.port}/?token={self.token}"

    @property
    def cookie(self) -> str:
        """Name of the cookie with the token. Cookies of one host are shared by all of its ports."""
        return f"skyherd_{self.port}"

    def allows_host(self, header: str) -> bool:
        """Return whether a header `Host` names this server."""
        name, _, port = header.rpartition(":")
        if port != str(self.port):
            return False
        names = {*LOOPBACK, self.host, f"[{self.host}]"}
        return name in names or (self.host in ("0.0.0.0", "::") and _is_own_name(name))

    def refusal(self, headers: Mapping[str, str], *, is_socket: bool) -> str | None:
        """Return the reason to refuse a request with a cookie, or None.

        Args:
            headers: values of `Host`, `Origin` and `Cookie`; those that are absent are empty.
            is_socket: True for a WebSocket.
        """
        host, origin = headers["Host"], headers["Origin"]
        if not self.allows_host(host):
            return "unknown host"
        if (is_socket or origin) and origin != f"http://{host}":
            return "foreign origin"
        if not self._matches(self._cookie_of(headers["Cookie"])):
            return "no valid token; open the address that was printed"
        return None

    def has_token(self, path: str, host: str) -> bool:
        """Return whether the address of a request carries the token, at an allowed host."""
        given = parse_qs(urlsplit(path).query).get("token", [""])[0]
        return self.allows_host(host) and self._matches(given)

    def _matches(self, given: str) -> bool:
        return compare_digest(given.encode("utf-8", "replace"), self.token.encode())

    def _cookie_of(self, header: str) -> str:
        try:
            found = SimpleCookie(header).get(self.cookie)
        except CookieError:
            return ""
        return found.value if found else ""


def _is_own_name(name: str) -> bool:
    """Return whether a host is an address, which cannot be rebound, or the name of this computer."""
    try:
        ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return name.lower() == socket.gethostname().lower()
    return True


def bind(host: str, port: int) -> socket.socket:
    """Return a socket that listens at an address; port 0 is any free one.

    Raises:
        InputError: the address is not one of this computer, or its port is in use.
    """
    try:
        family = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0][0]
        listener = socket.socket(family, socket.SOCK_STREAM)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    except (OSError, ValueError):
        raise InputError("host", f"no such address {host!r}", "an address of this computer") from None
    try:
        listener.bind((host, port))
        listener.listen()
    except OSError as error:
        listener.close()
        allowed = "another `port=`, or 0 for a free one"
        raise InputError("port", f"{port}: {error.strerror or error}", allowed) from None
    return listener
