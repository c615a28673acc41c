"""The console's front door: who may open the page at all.

viser itself knows no users, so it listens on loopback only and this small relay stands in front of it. It lets a
connection through when its Host and Origin are the console's own (a web page of somebody else's must not drive the
arm through the operator's browser) and, beyond loopback, when it carries the token: once as ``?token=``, then as a
cookie. Each connection carries one request or one websocket (viser answers "Connection: close"), so looking at its
head is enough.
"""

from __future__ import annotations

import asyncio
import contextlib
import errno
import hmac
import ipaddress
import logging
import string
import threading
from dataclasses import dataclass
from urllib.parse import parse_qs, urlsplit

from s2r_protocol.exits import NotReadyError, UsageError

logger = logging.getLogger(__name__)

COOKIE = "s2r_token"
MIN_TOKEN = 16
_TOKEN_SIGNS = "-._~/=+"
_TOKEN_CHARACTERS = frozenset(string.ascii_letters + string.digits + _TOKEN_SIGNS)
_HEAD_BYTES = 16 * 1024
_HEAD_TIMEOUT_S = 5.0
_HTML = "text/html; charset=utf-8"


class ConsoleAddressError(UsageError):
    """The console may not listen there."""


@dataclass(frozen=True)
class Address:
    """Where the console listens, and the token it then wants; empty on loopback."""

    host: str
    port: int
    token: str = ""

    def __post_init__(self) -> None:
        if not is_loopback(self.host) and not self.token:
            raise ConsoleAddressError(
                f"will not open the console on {self.host} without a token: anybody on that network could press its "
                "buttons. Add --token-file FILE (at least 16 characters), or use --host 127.0.0.1"
            )
        if self.token and len(self.token) < MIN_TOKEN:
            raise ConsoleAddressError(
                f"the console's token has {len(self.token)} characters, needs at least {MIN_TOKEN}; "
                "make one with: openssl rand -hex 16"
            )
        if set(self.token) - _TOKEN_CHARACTERS:
            raise ConsoleAddressError(
                "the console's token has characters that an address or a cookie does not carry as they are, so that "
                f"nobody would get in; use letters, digits and {_TOKEN_SIGNS}, or make one with: openssl rand -hex 16"
            )


def is_loopback(host: str) -> bool:
    """Whether an address stays on this machine; a name other than localhost does not count."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


@dataclass(frozen=True)
class Request:
    """The head of an HTTP request."""

    target: str
    headers: dict[str, str]

    @staticmethod
    def parse(head: bytes) -> Request | None:
        """None when it is no HTTP request."""
        lines = head.decode("latin-1").split("\r\n")
        parts = lines[0].split(" ")
        if len(parts) != 3 or not parts[2].startswith("HTTP/1."):
            return None
        pairs = (line.partition(":") for line in lines[1:] if line)
        return Request(parts[1], {name.strip().lower(): value.strip() for name, _, value in pairs})


def judge(request: Request | None, address: Address) -> tuple[str, bytes]:
    """What to do with a request: ``("pass", b"")`` or ``("answer", bytes of a response)``."""
    if request is None:
        return "answer", _response("400 Bad Request", "This is the console's port; open it in a browser.")
    host, origin = request.headers.get("host", ""), request.headers.get("origin")
    try:
        name, page = urlsplit(f"//{host}").hostname or "", urlsplit(origin or "").netloc
    except ValueError:  # half an IPv6 address
        return "answer", _response("400 Bad Request", "No page has this address.")
    if is_loopback(address.host) and not is_loopback(name):
        return "answer", _response("403 Forbidden", "This console answers to localhost only.")
    if origin is not None and page != host:
        return "answer", _response("403 Forbidden", "Another page may not use this console.")
    if not address.token:
        return "pass", b""
    query = parse_qs(urlsplit(request.target).query.replace("+", "%2B"))  # no blank is in a token
    if hmac.compare_digest(query.get("token", [""])[0].encode(), address.token.encode()):
        cookie = f"Set-Cookie: {COOKIE}={address.token}; HttpOnly; SameSite=Strict; Path=/\r\n"
        return "answer", _response("303 See Other", "", f"Location: /\r\n{cookie}")
    if hmac.compare_digest(_cookie(request).encode(), address.token.encode()):
        return "pass", b""
    return "answer", _response("401 Unauthorized", "Add ?token=… to the address: the operator knows it.")


def _cookie(request: Request) -> str:
    for part in request.headers.get("cookie", "").split(";"):
        name, _, value = part.strip().partition("=")
        if name == COOKIE:
            return value
    return ""


def _response(status: str, text: str, more: str = "") -> bytes:
    body = f"<!doctype html><title>s2r console</title><p>{text}</p>".encode()
    head = f"HTTP/1.1 {status}\r\n{more}Content-Type: {_HTML}\r\nContent-Length: {len(body)}\r\n"
    head += "Connection: close\r\n\r\n"
    return head.encode() + body


class Gate:
    """The relay, in a thread of its own. A context manager."""

    def __init__(self, address: Address, inner_port: int) -> None:
        """Listen.

        Args:
            address: Where; port 0 takes a free one.
            inner_port: viser's, on loopback.

        Raises:
            NotReadyError: The address is taken or not ours.
        """
        self._address = address
        self._inner_port = inner_port
        self._loop = asyncio.new_event_loop()
        self._tasks: set[asyncio.Task[None]] = set()
        self._thread = threading.Thread(target=self._loop.run_forever, name="s2r-console-gate", daemon=True)
        self._thread.start()
        try:
            self._server = asyncio.run_coroutine_threadsafe(self._listen(), self._loop).result()
        except OSError as error:
            self._end_loop()
            raise NotReadyError(
                f"the console cannot listen on {address.host}:{address.port}: {error.strerror or error}; "
                + (
                    "is another console running? Choose another with --port"
                    if error.errno != errno.EADDRNOTAVAIL
                    else "name an address of this machine with --host"
                )
            ) from error
        self.port: int = self._server.sockets[0].getsockname()[1]

    async def _listen(self) -> asyncio.Server:
        return await asyncio.start_server(self._serve, self._address.host, self._address.port)

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        task = asyncio.current_task()
        assert task is not None
        self._tasks.add(task)
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), _HEAD_TIMEOUT_S)
            verdict, answer = judge(Request.parse(head) if len(head) <= _HEAD_BYTES else None, self._address)
            if verdict == "answer":
                writer.write(answer)
                await writer.drain()
                return
            await self._relay(head, reader, writer)
        except (TimeoutError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, ConnectionError):
            logger.debug("a browser's connection ended early")
        except asyncio.CancelledError:
            # By `close`, which waits for it: Python 3.11 reports a cancelled handler of a connection as an error.
            logger.debug("the console ends; a browser's connection was dropped")
        finally:
            self._tasks.discard(task)
            writer.close()

    async def _relay(self, head: bytes, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        inner_reader, inner_writer = await asyncio.open_connection("127.0.0.1", self._inner_port)
        inner_writer.write(head)
        ways = [
            asyncio.ensure_future(_copy(reader, inner_writer)),
            asyncio.ensure_future(_copy(inner_reader, writer)),
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            inner_writer.close()

    def _end_loop(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    def close(self) -> None:
        """Stop listening and drop all connections."""
        asyncio.run_coroutine_threadsafe(self._close(), self._loop).result()
        self._end_loop()

    async def _close(self) -> None:
        self._server.close()
        for task in list(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)

    def __enter__(self) -> Gate:
        return self

    def __exit__(self, *exc: object) -> None:
        self.close()


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    with contextlib.suppress(ConnectionError):
        while data := await reader.read(1 << 16):
            writer.write(data)
            await writer.drain()
