"""A live view without a display: a page on this machine that any browser shows."""

from __future__ import annotations

import logging
import select
import socket
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import TracebackType

import cv2
import numpy as np
from numpy.typing import NDArray

Image = NDArray[np.uint8]

HOST = "127.0.0.1"
MAX_VIEWERS = 8
_JPEG_QUALITY = 85
_SEND_TIMEOUT = 5.0  # s that a browser may take for one picture
_PATIENCE = 1.0  # s after which a viewer who waits is looked after
_CLOSE_TIMEOUT = 2.0
_BOUNDARY = "picture"
_PAGE = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><meta name="viewport" content="width=device-width">
<title>stereo-slam live</title>
<style>
html, body { margin: 0; min-height: 100%; background: #14171b; color: #c9ced6; font: 15px/1.5 system-ui, sans-serif; }
header { padding: 10px 16px; color: #8b929c; } header b { color: #f5f6f8; font-weight: 600; }
img { display: block; width: 100%; max-width: 1600px; margin: 0 auto; min-height: 40vh; object-fit: contain; }
</style></head>
<body><header><b>stereo-slam live</b> &middot; <span id="state">waiting for the first picture</span></header>
<img id="view" src="stream" alt="">
<script>
const view = document.getElementById("view"), state = document.getElementById("state");
const timer = setInterval(() => {
  if (view.naturalWidth) { state.textContent = view.naturalWidth + " x " + view.naturalHeight; clearInterval(timer); }
}, 200);
const alive = setInterval(() => fetch("/").catch(() => {
  clearInterval(timer); clearInterval(alive); state.textContent = "the run has ended";
}), 2000);
</script></body></html>
"""

log = logging.getLogger(__name__)


class _Latest:
    """The newest picture, for one producer and many viewers; older ones are lost."""

    def __init__(self) -> None:
        self.changed = threading.Condition()
        self.closed = False
        self.viewers = 0
        self._picture: Image | None = None
        self._number = 0
        self._encoding = threading.Lock()
        self._encoded: tuple[int, bytes] = (0, b"")

    def put(self, picture: Image) -> None:
        with self.changed:
            self._picture, self._number = picture, self._number + 1
            self.changed.notify_all()

    def after(self, number: int) -> tuple[int, bytes] | None:
        """Number and JPEG of a picture newer than `number`; no bytes if none came for a while; None once closed."""
        with self.changed:
            self.changed.wait_for(lambda: self.closed or self._number > number, _PATIENCE)
            if self.closed:
                return None
            if self._picture is None or self._number <= number:
                return number, b""
            picture, newest = self._picture, self._number
        with self._encoding:  # encoded once for all viewers, never in the producer's time
            if self._encoded[0] < newest:
                self._encoded = newest, _jpeg(picture)
            return self._encoded

    def enter(self) -> bool:
        with self.changed:
            if self.closed or self.viewers >= MAX_VIEWERS:
                return False
            self.viewers += 1
            return True

    def leave(self) -> None:
        with self.changed:
            self.viewers -= 1
            self.changed.notify_all()

    def close(self) -> None:
        """Send the viewers away, and wait for them a little."""
        with self.changed:
            self.closed = True
            self.changed.notify_all()
            self.changed.wait_for(lambda: self.viewers == 0, _CLOSE_TIMEOUT)


class LiveView:
    """Serves the newest picture as a stream to browsers on this machine; use it as a context manager.

    `show` never waits for a browser: who is too slow misses pictures.

    Parameters
    ----------
    port : int
        0 takes any free one.

    Raises
    ------
    ValueError
        The port cannot be used.
    """

    def __init__(self, port: int = 0) -> None:
        self._latest = _Latest()
        if isinstance(port, bool) or not isinstance(port, int) or not 0 <= port <= 65535:
            raise ValueError(f"port must be 0 to 65535, got {port!r}")
        try:
            self._server = _Server(self._latest, port)
        except OSError as error:
            raise ValueError(f"port {port} cannot be used ({error.strerror}): choose another, or 0 for any") from error
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name="live view", daemon=True)
        self._thread.start()
        self._open = True

    @property
    def url(self) -> str:
        """The page."""
        return f"http://{HOST}:{self._server.server_port}/"

    def show(self, picture: Image) -> None:
        """Make (H, W, 3) uint8 RGB the newest picture; it is copied.

        Raises
        ------
        ValueError
            It is not of that form, or the view is closed.
        """
        if picture.ndim != 3 or picture.shape[2] != 3 or picture.dtype != np.uint8:
            raise ValueError(f"picture must be uint8 of shape (H, W, 3), got {picture.dtype} of shape {picture.shape}")
        if not self._open:
            raise ValueError("the live view is closed: make another one")
        self._latest.put(picture.copy())

    def close(self) -> None:
        """Stop serving; may be called twice."""
        if not self._open:
            return
        self._open = False
        self._latest.close()
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def __enter__(self) -> LiveView:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class _Server(ThreadingHTTPServer):
    daemon_threads = True

    def __init__(self, latest: _Latest, port: int) -> None:
        self.latest = latest
        super().__init__((HOST, port), _Handler)

    def handle_error(self, request: object, client_address: object) -> None:
        log.debug("a viewer went away", exc_info=True)


class _Handler(BaseHTTPRequestHandler):
    server: _Server
    timeout = _SEND_TIMEOUT

    def do_GET(self) -> None:
        path = self.path.partition("?")[0]
        if path == "/":
            self._send("text/html; charset=utf-8", _PAGE.encode())
        elif path in ("/stream", "/picture.jpg"):
            if not self.server.latest.enter():
                self.send_error(503, f"at most {MAX_VIEWERS} viewers at a time")
                return
            try:
                self._stream() if path == "/stream" else self._picture()
            finally:
                self.server.latest.leave()
        else:
            self.send_error(404)

    def _stream(self) -> None:
        self.send_response(200)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Type", f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        self.end_headers()
        # The boundary goes out right after a picture, for browsers show it only when they see the next boundary.
        self.wfile.write(f"--{_BOUNDARY}\r\n".encode())
        number = 0
        while (found := self.server.latest.after(number)) is not None:
            number, data = found
            if not data:
                if self._gone():
                    return
                continue
            head = f"Content-Type: image/jpeg\r\nContent-Length: {len(data)}\r\n\r\n".encode()
            self.wfile.write(head + data + f"\r\n--{_BOUNDARY}\r\n".encode())

    def _gone(self) -> bool:
        """Whether the browser has hung up."""
        readable, _, _ = select.select([self.connection], [], [], 0)
        return bool(readable) and not self.connection.recv(1, socket.MSG_PEEK)

    def _picture(self) -> None:
        found = self.server.latest.after(0)
        if found is None or not found[1]:
            self.send_error(503, "there is no picture yet")
        else:
            self._send("image/jpeg", found[1])

    def _send(self, kind: str, content: bytes) -> None:
        self.send_response(200)
        self.send_header("Cache-Control", "no-store")
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        log.debug("%s " + format, time.strftime("%X"), *args)


def _jpeg(picture: Image) -> bytes:
    done, data = cv2.imencode(
        ".jpg", cv2.cvtColor(picture, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
    )
    if not done:
        raise ValueError("OpenCV could not encode a picture as JPEG")
    return bytes(data)
