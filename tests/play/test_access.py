"""Access to the page: tokens, hosts and origins, and messages that are acted on."""

import asyncio
import http.client
import random
import socket
from contextlib import ExitStack, closing, suppress
from dataclasses import asdict, replace

import msgspec
import pytest
import viser
import websockets
from play_pages import run_async, wait_until
from viser._messages import (
    SceneNodeClickMessage,
    TransformControlsDragEndMessage,
    TransformControlsDragStartMessage,
    TransformControlsUpdateMessage,
)

from skyherd.errors import InputError
from skyherd.play.grab import NAME
from skyherd.play.server import MAX_REFUSED
from skyherd.play.session import Pause
from skyherd.report.access import Access, bind

ACCESS = Access("127.0.0.1", 8440, "secret")
COOKIE = "skyherd_8440=secret"


def headers(host="127.0.0.1:8440", origin="", cookie=COOKIE):
    return {"Host": host, "Origin": origin, "Cookie": cookie}


class TestRules:
    @pytest.mark.parametrize("host", ["127.0.0.1:8440", "localhost:8440", "[::1]:8440"])
    def test_page_of_this_computer_is_allowed(self, host):
        assert ACCESS.refusal(headers(host), is_socket=False) is None
        assert ACCESS.refusal(headers(host, f"http://{host}"), is_socket=True) is None

    @pytest.mark.parametrize(
        "host",
        [
            "",
            "127.0.0.1",
            "127.0.0.1:80",
            "evil.example:8440",
            "127.0.0.1.evil.example:8440",
            "192.168.1.7:8440",
        ],
    )
    def test_other_host_is_refused(self, host):
        assert ACCESS.refusal(headers(host), is_socket=False) == "unknown host"
        assert not ACCESS.has_token("/?token=secret", host)

    @pytest.mark.parametrize(
        "origin", ["", "null", "http://evil.example", "https://127.0.0.1:8440", "http://localhost:8440"]
    )
    def test_socket_of_other_origin_is_refused(self, origin):
        assert ACCESS.refusal(headers(origin=origin), is_socket=True) == "foreign origin"

    @pytest.mark.parametrize(
        "cookie",
        ["", "skyherd_8440=", "skyherd_play_8440=secre", "skyherd_play_80=secret", "\x00;=;\xff"],
    )
    def test_wrong_cookie_is_refused(self, cookie):
        assert "token" in ACCESS.refusal(headers(cookie=cookie), is_socket=False)

    def test_wide_server_allows_addresses_and_its_name_only(self):
        wide = replace(ACCESS, host="0.0.0.0")
        assert wide.allows_host("192.168.1.7:8440") and wide.allows_host(f"{socket.gethostname()}:8440")
        assert not wide.allows_host("evil.example:8440")
        assert wide.url == "http://127.0.0.1:8440/?token=secret"

    def test_tokens_differ_and_are_long(self):
        tokens = {Access.make("127.0.0.1", 1).token for _ in range(20)}
        assert len(tokens) == 20 and min(map(len, tokens)) >= 32


def test_taken_port_is_one_error():
    with bind("127.0.0.1", 0) as first, pytest.raises(InputError, match=r"^port: "):
        bind("127.0.0.1", first.getsockname()[1])
    with pytest.raises(InputError, match="no such address"):
        bind("no-such-host.invalid", 0)


def get(access, path, **sent):
    """Return status, headers and body of a request."""
    with closing(http.client.HTTPConnection("127.0.0.1", access.port, timeout=10)) as connection:
        connection.request("GET", path, headers={"Host": f"127.0.0.1:{access.port}", **sent})
        answer = connection.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()


def cookie_of(access):
    return get(access, f"/?token={access.token}")[1]["Set-Cookie"].split(";")[0]


def connect(access, **changed):
    """Return a WebSocket, to be opened in an `async with` statement; headers may be changed."""
    host = f"127.0.0.1:{access.port}"
    sent = {"Origin": f"http://{host}", "Cookie": f"{access.cookie}={access.token}", **changed}
    protocol = sent.pop("protocol", f"viser-v{viser.__version__}")
    return websockets.connect(
        f"ws://{host}",
        origin=sent.pop("Origin"),
        additional_headers=sent,
        subprotocols=[protocol],
        max_size=None,
        max_queue=None,  # A browser reads all that it gets, so that it also gets the end of the connection.
    )


def upgrade(access):
    """Return the request of a WebSocket by the page itself, as bytes."""
    host = f"127.0.0.1:{access.port}"
    sent = {
        "Host": host,
        "Origin": f"http://{host}",
        "Cookie": f"{access.cookie}={access.token}",
        "Upgrade": "websocket",
        "Connection": "Upgrade",
        "Sec-WebSocket-Version": "13",
        "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
        "Sec-WebSocket-Protocol": f"viser-v{viser.__version__}",
    }
    return "\r\n".join(
        ["GET / HTTP/1.1", *(f"{key}: {value}" for key, value in sent.items()), "", ""]
    ).encode()


class TestServer:
    def test_page_needs_the_token(self, open_page):
        with open_page() as page:
            access = page.access
            for path in ("/", "/?token=wrong", "/index.html", f"/?token={access.token[:-1]}"):
                status, _, body = get(access, path)
                assert status == 403 and body.startswith(b"refused: no valid token")
            status, sent, _ = get(access, f"/?token={access.token}")
            assert (status, sent["Location"]) == (303, "/")
            assert "HttpOnly" in sent["Set-Cookie"] and "SameSite=Strict" in sent["Set-Cookie"]
            status, sent, body = get(access, "/", Cookie=cookie_of(access))
            assert status == 200 and b"<html" in body.lower()
            assert sent["Content-Security-Policy"] == "frame-ancestors 'none'"

    def test_rebound_name_is_refused_with_the_token(self, open_page):
        with open_page() as page:
            access = page.access
            for path in ("/", f"/?token={access.token}"):
                sent = {"Host": f"evil.example:{access.port}", "Cookie": f"{access.cookie}={access.token}"}
                assert get(access, path, **sent)[0] == 403

    @pytest.mark.parametrize(
        "changed",
        [
            {"Origin": "http://evil.example"},
            {"Origin": None},
            {"Cookie": "skyherd_1=x"},
            {"Host": "evil.example:80"},
            {"protocol": "viser-v0.0.1"},
        ],
        ids=str,
    )
    def test_socket_is_refused(self, open_page, changed):
        async def attack():
            async with connect(page.access, **changed):
                pass

        with open_page() as page, pytest.raises(websockets.InvalidStatus, match="403"):
            run_async(attack())

    def test_hostile_messages_change_nothing(self, open_page, capfd, monkeypatch):
        """300 messages: malformed, oversized, unknown kinds, foreign controls, wrong values.

        The browser is registered by a valid message first; the last one is valid, too, as negative control.
        """
        with open_page(speed=1.0) as page, monkeypatch.context() as patch:
            asked, seed = [], page._panel._seed.value
            page._panel._sketch.begin()
            patch.setattr(page.session, "ask", asked.append)

            async def attack():
                for some in chunks(hostile_messages(page), 15):
                    async with connect(page.access) as socket:
                        await socket.send(CAMERA)
                        while not page.server.get_clients():
                            await asyncio.sleep(0.02)
                        with suppress(websockets.ConnectionClosed):
                            for raw in some:
                                await socket.send(raw)
                    while page.server.get_clients():
                        await asyncio.sleep(0.02)
                assert asked == [] and page._panel._seed.value == seed and not page._panel._sketch.count
                async with connect(page.access) as socket:
                    await socket.send(CAMERA)
                    await socket.send(update(page._panel._pause, value=True))
                    while not asked:
                        await asyncio.sleep(0.02)

            run_async(asyncio.wait_for(attack(), 60))
            assert asked == [Pause(True)] and page.server._share_tunnel is None
        said = capfd.readouterr()
        assert "Traceback" not in said.out + said.err

    def test_valid_message_is_acted_on(self, open_page):
        """Negative control: the same connection can pause the session."""
        with open_page(speed=1.0) as page:

            async def press():
                async with connect(page.access) as socket:
                    await socket.send(CAMERA)
                    await asyncio.sleep(0.5)
                    await socket.send(update(page._panel._pause, value=True))
                    for _ in range(50):
                        await asyncio.sleep(0.1)
                        if page.session.is_paused:
                            return

            run_async(press())
            assert page.session.is_paused

    def test_messages_of_a_click_and_a_drag_move_the_robot(self, open_page):
        """They have the form of viser's own messages."""
        with open_page(speed=1.0) as page:
            grab, number = page._panel._grab, page._scene._ids.tolist()[4]
            turn, place = {"wxyz": (1.0, 0.0, 0.0, 0.0)}, {"position": (9.0, 1.0, 0.0)}
            rays = {
                "ray_origin": (0.0, 0.0, 9.0),
                "ray_direction": (0.0, 0.0, -1.0),
                "screen_pos": (0.5, 0.5),
            }
            click = SceneNodeClickMessage(f"/robots/{number}/card", None, modifier=None, **rays)
            drag = [
                TransformControlsDragStartMessage(NAME),
                TransformControlsUpdateMessage(NAME, **turn, **place),
                TransformControlsDragEndMessage(NAME),
            ]

            async def act():
                async with connect(page.access) as browser:
                    await browser.send(CAMERA)
                    await browser.send(packed(click))
                    while grab._held is None or not grab._held.node.visible:
                        await asyncio.sleep(0.05)
                    for message in drag:
                        await browser.send(packed(message))
                        await asyncio.sleep(0.1)
                    while not page.session.added:
                        await asyncio.sleep(0.05)

            run_async(asyncio.wait_for(act(), 20))
            (change,) = page.session.added
            assert (change.kind, change.robot, change.position_m) == ("robot", number, (9.0, 1.0))

    def test_browsers_that_read_nothing_do_not_hold_the_loop(self, open_page):
        with open_page() as page, ExitStack() as stack:
            for _ in range(3):
                browser = stack.enter_context(socket.create_connection(("127.0.0.1", page.access.port)))
                browser.sendall(upgrade(page.access))
                assert b"101" in browser.recv(20)
            wait_until(lambda: page._step is not None)
            time_s = page._step.time_s
            wait_until(lambda: page._step.time_s > time_s + 20)

    @pytest.mark.parametrize(
        "raw", [b"", b"\x00" * 999, b"GET / HTTP/9\r\n\r\n", b"GET " + b"x" * 10**6], ids=len
    )
    def test_malformed_request_does_not_hold_the_loop(self, open_page, raw, capfd):
        with open_page() as page:
            with closing(socket.create_connection(("127.0.0.1", page.access.port))) as attacker:
                with suppress(OSError):
                    attacker.sendall(raw)
                    attacker.shutdown(socket.SHUT_WR)
                attacker.settimeout(10)
                with suppress(ConnectionError):
                    assert b"200" not in attacker.recv(4096)[:20]
            wait_until(lambda: page._step is not None)
            time_s = page._step.time_s
            wait_until(lambda: page._step.time_s > time_s)
        said = capfd.readouterr()
        assert "Traceback" not in said.out + said.err

    def test_connection_of_an_attacker_is_closed(self, open_page):
        with open_page(speed=1.0) as page:

            async def attack():
                async with connect(page.access) as socket:
                    for _ in range(MAX_REFUSED):
                        await socket.send(b"\x00")
                    with pytest.raises(websockets.ConnectionClosed) as closed:
                        while True:
                            await socket.recv()
                assert closed.value.rcvd.code == 1008

            run_async(asyncio.wait_for(attack(), 20))


CAMERA = msgspec.msgpack.encode(
    {
        "type": "ViewerCameraMessage",
        "wxyz": [1, 0, 0, 0],
        "position": [0, 0, 9.5],
        "fov": 1.0,
        "near": 0.1,
        "far": 100,
        "image_height": 600,
        "image_width": 800,
        "look_at": [0, 0, 0],
        "up_direction": [0, 0, 1],
    }
)


def packed(message):
    """Return a message as viser's client sends it."""
    return msgspec.msgpack.encode({"type": type(message).__name__, **asdict(message)})


def update(handle, **updates):
    return msgspec.msgpack.encode({"type": "GuiUpdateMessage", "uuid": handle._impl.uuid, "updates": updates})


def chunks(items, size):
    return [items[k : k + size] for k in range(0, len(items), size)]


def hostile_messages(page):
    """Return 300 messages, none of which may have an effect; seeded."""
    rng, panel = random.Random(4), page._panel
    kinds = ("ShareUrlRequest", "ShareUrlDisconnect", "FileTransferStartUpload", "GetRenderResponseMessage",
             "GuiFormSubmitMessage", "RemoveSceneNodeMessage", "__class__", "")  # fmt: skip
    # viser sets any attribute of a control that a message names.
    messages = [update(panel._pause, value=True, update_cb=[]), update(panel._pause, update_cb=[])]
    messages += [update(panel._pause, value=True, label="x"), update(panel._pause)]
    messages += [msgspec.msgpack.encode({"type": kind}) for kind in kinds]
    messages += [msgspec.msgpack.encode(value) for value in (None, 1, [], {}, "x", {"type": 3}, {"type": []})]
    messages += [b"\x91" * 20_000, b"\x91" * 5_000, b"\xdf\xff\xff\xff\xff", CAMERA[:-3], CAMERA * 9]
    wrong = (None, -1, 2**40, float("nan"), float("inf"), "x", "x" * 5000, [], {}, [1, 2])
    messages += [update(panel._seed, value=value) for value in wrong]
    messages += [update(panel._speed, value=value) for value in (*wrong[:5], "__class__", *wrong[7:])]
    messages += [update(panel._pause, value=value) for value in wrong]
    messages += [update(panel._pause, **{key: True}) for key in ("label", "_impl", "__class__", "disabled")]
    camera = msgspec.msgpack.decode(CAMERA)
    messages += [msgspec.msgpack.encode({**camera, key: "x"}) for key in camera]
    messages += [
        msgspec.msgpack.encode({**camera, "fov": value}) for value in (float("nan"), float("inf"), 1e300)
    ]
    click = {
        "type": "ScenePointerMessage",
        "event_type": "click",
        "ray_origin": [0.0, 0.0, 9.0],
        "ray_direction": [0.1, 0.0, -1.0],
        "screen_pos": [[0.5, 0.5]],
        "modifier": None,
    }
    changes = [{"event_type": "rect-select"}, {"ray_origin": None}, {"ray_origin": [0.0, 0.0, float("nan")]}]
    changes += [{"ray_direction": [0.0, 0.0]}, {"ray_direction": [0.0, 0.0, 1e300]}, {"screen_pos": []}]
    messages += [msgspec.msgpack.encode({**click, **change}) for change in (*changes, {"owner": "x" * 999})]
    messages += ["text", *(rng.randbytes(rng.randrange(1, 400)) for _ in range(300 - len(messages)))][
        : 300 - len(messages)
    ]
    return messages
