"""Lines of text over TCP, with a time limit on every operation and a bound on every length.

The client side is `Line`. The server side, `Server`, is for simulated devices and listens on the loopback interface
alone.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable
from types import TracebackType

__all__ = ["LONGEST", "Line", "LinkError", "Server", "answering"]

LONGEST = 8192
"""Most bytes of a line."""
_MOST_CONNECTIONS = 4
_IDLE = 60.0  # [s] after which a server ends a connection that is silent


class LinkError(Exception):
    """The connection is lost, or what came over it is not what was expected. It is not used again."""


class Line:
    """A connection that sends bytes and receives lines.

    A reply that is late would be taken for the reply to the next request. Therefore the first failure ends the
    connection: later calls raise `LinkError` at once.

    Parameters
    ----------
    host, port
        Of the device.
    timeout
        Of each operation as a whole [s], whatever number of pieces a line arrives in.
    """

    def __init__(self, host: str, port: int, timeout: float = 0.5) -> None:
        self.host, self.port, self.timeout = host, port, timeout
        self._received = b""
        try:
            self._socket: socket.socket | None = socket.create_connection((host, port), timeout)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        except OSError as error:
            self._socket = None
            raise LinkError(f"{host}:{port}: no connection ({error})") from None

    def send(self, data: bytes) -> None:
        """Send all bytes. What came without a request before would be taken for the reply: it ends the connection."""
        link = self._open()
        try:
            link.setblocking(False)
            with contextlib.suppress(BlockingIOError):
                self._received += link.recv(1)
                if not self._received:
                    raise self._lost("closed by the other side")
            if self._received:
                raise self._lost("the other side sent what was not asked for")
            link.settimeout(self.timeout)
            link.sendall(data)
        except OSError as error:
            raise self._lost(f"nothing can be sent ({error})") from None

    def deadline(self) -> float:
        """Return when an operation that begins now has to be over, a time of `time.monotonic` [s]."""
        return time.monotonic() + self.timeout

    def receive(self, deadline: float | None = None) -> bytes:
        """Return the next line without its end.

        Parameters
        ----------
        deadline
            Of the operation that this line is part of, from `deadline`; None: the line is all of it.
        """
        link = self._open()
        deadline = self.deadline() if deadline is None else deadline
        while b"\n" not in self._received:
            if len(self._received) > LONGEST:
                raise self._lost(f"expected lines of at most {LONGEST} bytes, got a longer one")
            left = deadline - time.monotonic()
            if left <= 0.0:
                raise self._lost(f"no reply within {self.timeout} s")
            try:
                link.settimeout(left)
                data = link.recv(4096)
            except TimeoutError:
                continue
            except OSError as error:
                raise self._lost(f"nothing can be received ({error})") from None
            if not data:
                raise self._lost("closed by the other side")
            self._received += data
        line, _, self._received = self._received.partition(b"\n")
        if len(line) > LONGEST:
            raise self._lost(f"expected lines of at most {LONGEST} bytes, got a longer one")
        return line.removesuffix(b"\r")

    def close(self) -> None:
        """End the connection."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None

    def _open(self) -> socket.socket:
        if self._socket is None:
            raise LinkError(f"{self.host}:{self.port}: the connection was closed before")
        return self._socket

    def _lost(self, why: str) -> LinkError:
        self.close()
        return LinkError(f"{self.host}:{self.port}: {why}")


def answering(answer: Callable[[bytes], bytes | None]) -> Callable[[bytes], bytes | None]:
    """Return a handler for `Server` that gives each line to a function; lines that are too long end the connection."""
    received = b""

    def handle(data: bytes) -> bytes | None:
        nonlocal received
        *lines, received = (received + data).split(b"\n")
        if len(received) > LONGEST:
            return None
        replies = [answer(line) for line in lines]
        return None if None in replies else b"".join(reply for reply in replies if reply is not None)

    return handle


class Server:
    """A server on the loopback interface: bytes of each connection go to a handler, whose reply is sent back.

    Parameters
    ----------
    make_handler
        Makes the handler of a connection: a function from the bytes that came to those of the reply. None ends the
        connection.
    port
        0: any that is free.
    """

    def __init__(self, make_handler: Callable[[], Callable[[bytes], bytes | None]], port: int = 0) -> None:
        self._make_handler = make_handler
        self._ends = threading.Event()
        self._threads: list[threading.Thread] = []
        self._connections: set[socket.socket] = set()
        self._lock = threading.Lock()
        self._listening = socket.create_server(("127.0.0.1", port))
        self.port: int = self._listening.getsockname()[1]

    def __enter__(self) -> Server:
        """Accept connections in a thread."""
        self._start(self._accept)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """End all connections and wait for the threads."""
        self._ends.set()
        with contextlib.suppress(OSError):
            self._listening.shutdown(socket.SHUT_RDWR)  # ends the wait for connections
        self._listening.close()
        self.drop()
        for thread in self._threads:
            thread.join(2.0)

    def drop(self) -> None:
        """Close all connections, as a cable that is pulled would."""
        with self._lock:
            for connection in self._connections:
                with contextlib.suppress(OSError):
                    connection.shutdown(socket.SHUT_RDWR)

    def _start(self, target: Callable[..., None], *arguments: socket.socket) -> None:
        thread = threading.Thread(target=target, args=arguments, daemon=True)
        self._threads.append(thread)
        thread.start()

    def _accept(self) -> None:
        while not self._ends.is_set():
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            with self._lock:
                full = len(self._connections) == _MOST_CONNECTIONS or self._ends.is_set()
                if not full:
                    self._connections.add(connection)
            if full:
                connection.close()
                continue
            self._threads = [thread for thread in self._threads if thread.is_alive()]
            self._start(self._serve, connection)

    def _serve(self, connection: socket.socket) -> None:
        handler = self._make_handler()
        try:
            connection.settimeout(_IDLE)
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            while not self._ends.is_set():
                data = connection.recv(4096)
                reply = handler(data) if data else None
                if reply is None:
                    return
                connection.sendall(reply)
        except OSError:
            return
        finally:
            with self._lock:
                self._connections.discard(connection)
            connection.close()
