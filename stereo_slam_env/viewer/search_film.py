"""Show how the front end searches, as a film, live, or both."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from stereo_slam_env.frontend.tracks import TrackedPair
from stereo_slam_env.recording.image_sequence import StereoPair
from stereo_slam_env.rendering.images import Image
from stereo_slam_env.viewer.live import LiveView
from stereo_slam_env.viewer.search_view import search_picture
from stereo_slam_env.viewer.video import Recorder


@contextmanager
def search_film(
    title: str,
    record: str | Path | None = None,
    live_port: int | None = None,
    *,
    on_live: Callable[[str], None] | None = None,
) -> Iterator[Callable[[StereoPair, TrackedPair], None]]:
    """A function that takes each pair with what was found in it, for the `watch` of the front end.

    Parameters
    ----------
    title : str
        First words of the caption.
    record : str or Path, optional
        An mp4 file to write.
    live_port : int, optional
        Serve the latest picture to browsers on this machine at this port; 0 takes any free one.
    on_live : callable, optional
        Called with the address of the live view.

    Raises
    ------
    ValueError
        The file cannot be written or the port not be used.
    """
    with ExitStack() as stack:
        sinks: list[Callable[[Image], None]] = []
        if record is not None:
            sinks.append(stack.enter_context(Recorder(record)).write)
        if live_port is not None:
            view = stack.enter_context(LiveView(live_port))
            if on_live is not None:
                on_live(view.url)
            sinks.append(view.show)
        started: list[float] = []

        def watch(pair: StereoPair, tracked: TrackedPair) -> None:
            started.append(pair.timestamp)
            caption = (title, f"pair {len(started) - 1}", f"t = {pair.timestamp - started[0]:.1f} s")
            picture = search_picture(pair.left, pair.right, tracked, caption)
            for sink in sinks:
                sink(picture)

        yield watch
