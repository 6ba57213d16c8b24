"""The live view over the loopback interface, as a browser sees it (3 s)."""

import http.client
import socket
import threading
import time

import cv2
import numpy as np
import pytest

from stereo_slam_env.viewer.live import MAX_VIEWERS, LiveView


def picture(level, size=(60, 80)):
    return np.full((*size, 3), level, dtype=np.uint8)


def connect(view):
    host, port = view.url.removeprefix("http://").rstrip("/").split(":")
    assert host == "127.0.0.1"
    return http.client.HTTPConnection(host, int(port), timeout=5)


def get(view, path):
    connection = connect(view)
    connection.request("GET", path)
    return connection, connection.getresponse()


def next_jpeg(response):
    """One part of the stream, decoded."""
    length = None
    while (line := response.readline().strip()) or length is None:
        if line.lower().startswith(b"content-length"):
            length = int(line.split(b":")[1])
    data = response.read(length)
    return cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)


@pytest.fixture
def view():
    with LiveView() as live:
        yield live


def test_the_page_shows_the_stream(view):
    connection, response = get(view, "/")
    assert response.status == 200
    assert response.headers["Content-Type"].startswith("text/html")
    assert '<img id="view" src="stream"' in response.read().decode()
    connection.close()


def test_the_stream_brings_the_newest_picture_and_those_that_follow(view):
    view.show(picture(10))
    view.show(picture(200))
    connection, response = get(view, "/stream")
    assert response.headers["Content-Type"].startswith("multipart/x-mixed-replace")
    first = next_jpeg(response)
    assert first.shape == (60, 80, 3)
    assert first.mean() == pytest.approx(200, abs=3)
    view.show(picture(90))
    assert next_jpeg(response).mean() == pytest.approx(90, abs=3)
    connection.close()


def test_colours_are_those_of_the_picture(view):
    red = picture(0)
    red[:, :, 0] = 220
    view.show(red)
    connection, response = get(view, "/picture.jpg")
    shown = cv2.imdecode(np.frombuffer(response.read(), dtype=np.uint8), cv2.IMREAD_COLOR)
    assert shown[:, :, 2].mean() > 200  # OpenCV has blue first
    assert shown[:, :, :2].mean() < 20
    connection.close()


def test_a_browser_that_reads_nothing_never_holds_up_the_producer(view):
    noise = np.random.default_rng(0).integers(0, 255, (400, 600, 3), dtype=np.uint8)
    view.show(noise)
    stuck = socket.create_connection(("127.0.0.1", int(view.url.rsplit(":", 1)[1].rstrip("/"))))
    stuck.sendall(b"GET /stream HTTP/1.0\r\n\r\n")
    started = time.perf_counter()
    for _ in range(200):
        view.show(noise)
    assert time.perf_counter() - started < 2.0
    stuck.close()


def test_the_number_of_viewers_is_bounded_and_places_become_free(view):
    view.show(picture(50))
    connections = [get(view, "/stream") for _ in range(MAX_VIEWERS)]
    connection, response = get(view, "/stream")
    assert response.status == 503
    connection.close()
    for viewer, reading in connections:
        reading.close()
        viewer.close()
    deadline = time.monotonic() + 5.0
    while (status := get(view, "/picture.jpg")[1].status) == 503 and time.monotonic() < deadline:
        time.sleep(0.1)
    assert status == 200


def test_closing_ends_streams_threads_and_the_port():
    before = threading.active_count()
    view = LiveView()
    view.show(picture(50))
    _, response = get(view, "/stream")
    next_jpeg(response)
    started = time.monotonic()
    view.close()
    view.close()
    assert time.monotonic() - started < 1.5
    assert response.read().strip() == b"--picture"  # what ended the last part, and no more
    deadline = time.monotonic() + 2.0
    while threading.active_count() > before and time.monotonic() < deadline:
        time.sleep(0.02)
    assert threading.active_count() <= before
    with pytest.raises(OSError):  # noqa: PT011
        connect(view).request("GET", "/")
    with pytest.raises(ValueError, match="the live view is closed"):
        view.show(picture(1))


def test_unknown_pages_wrong_pictures_and_ports(view):
    assert get(view, "/../etc/passwd")[1].status == 404
    with pytest.raises(ValueError, match=r"picture must be uint8 of shape \(H, W, 3\)"):
        view.show(np.zeros((5, 5, 3)))
    port = int(view.url.rsplit(":", 1)[1].rstrip("/"))
    with pytest.raises(ValueError, match=rf"port {port} cannot be used \(Address already in use\): choose another"):
        LiveView(port)
    with pytest.raises(ValueError, match="port must be 0 to 65535, got 70000"):
        LiveView(70000)
