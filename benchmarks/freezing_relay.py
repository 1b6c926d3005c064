"""A relay that stops carrying anything between those that are linked, and links others at once: a network cut off."""

import contextlib
import socket
import threading

SMALL_BUFFER = 4096
"""Room for what the router sends: it soon waits for more, as it does where nothing is acknowledged."""


class Relay:
    """Between one client and the router; what is linked when it freezes hears nothing any more, and is not told."""

    def __init__(self, port: int) -> None:
        self._to, self._frozen = port, threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._kept: list[socket.socket] = []
        threading.Thread(target=self._accept, daemon=True).start()

    def freeze(self) -> None:
        """Carry nothing more between those that are linked now."""
        self._frozen.set()
        self._frozen = threading.Event()

    def close(self) -> None:
        """End everything."""
        self.freeze()
        for one in (self._listener, *self._kept):
            one.close()

    def _accept(self) -> None:
        with contextlib.suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                router = socket.socket()
                router.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL_BUFFER)
                router.connect(("127.0.0.1", self._to))
                self._kept += [client, router]
                for ends in ((client, router), (router, client)):
                    threading.Thread(target=_carry, args=(*ends, self._frozen), daemon=True).start()


def _carry(source: socket.socket, target: socket.socket, frozen: threading.Event) -> None:
    with contextlib.suppress(OSError):
        while (data := source.recv(1 << 16)) and not frozen.is_set():
            target.sendall(data)
        if not frozen.is_set():
            target.shutdown(socket.SHUT_RDWR)
