"""What the servers of the tests share: threads that serve one connection each, on loopback, and all end together."""

import socket
import threading
import time
from types import TracebackType
from typing import Self


class LoopbackServer:
    """Accepts connections until it is left; subclasses say what happens on one."""

    def __init__(self) -> None:
        self.connections = 0
        self.stopping = threading.Event()
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = int(self._listener.getsockname()[1])
        self._open: list[socket.socket] = []
        self._threads = [threading.Thread(target=self._accept, name="test-server")]

    def __enter__(self) -> Self:
        self._threads[0].start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stopping.set()
        # Closing alone does not wake a thread that waits in accept or recv.
        shut_down(self._listener)
        self._threads[0].join()
        for sock in self._open:
            shut_down(sock)
        for thread in self._threads[1:]:
            thread.join()
        self._listener.close()

    def disconnect_all(self) -> None:
        """Cut all connections, as a pulled cable would in the end."""
        for sock in self._open:
            shut_down(sock)

    def wait_until(self, begin_s: float, after_s: float) -> bool:
        """Keep a steady rate whatever sending costs; true when the server is being left.

        Parameters
        ----------
        begin_s, after_s
            A moment of `time.monotonic`, and seconds after it.
        """
        return self.stopping.wait(max(0.0, begin_s + after_s - time.monotonic()))

    def serve(self, sock: socket.socket, number: int) -> None:
        """Serve one connection; ends when this returns or raises OSError.

        Parameters
        ----------
        number
            Connections before this one.
        """
        raise NotImplementedError

    def _accept(self) -> None:
        while not self.stopping.is_set():
            try:
                sock, _ = self._listener.accept()
            except OSError:
                return
            self._open.append(sock)
            thread = threading.Thread(target=self._serve, args=(sock, self.connections), name="test-connection")
            self.connections += 1
            self._threads.append(thread)
            thread.start()

    def _serve(self, sock: socket.socket, number: int) -> None:
        with sock:
            try:
                self.serve(sock, number)
            except OSError:
                return


def shut_down(sock: socket.socket) -> None:
    """Wake whoever waits on a socket; one that is closed already needs no waking."""
    try:
        sock.shutdown(socket.SHUT_RDWR)
    except OSError:
        return
