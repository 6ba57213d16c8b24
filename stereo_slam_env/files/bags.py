"""The one way to open a ROS bag: what is in it is counted first, so that a small file cannot fill memory, disk or time.

Libraries unpack what a file says, however much that is, run what a database defines, and make code of what a bag says
that its messages are. So, before: chunks are looked at in their headers and in those of their blocks, a database may
have tables and indices alone, and YAML is that of `yaml_files`. Then, before types are made of them: the number of
topics, and the definitions of messages. Nothing healthy is unpacked twice, but for chunks packed by bzip2.
"""

from __future__ import annotations

import json
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any, BinaryIO
from urllib.parse import quote

from filters.contract.validation import first_line
from stereo_slam_env.files.bag_records import BagTooLarge, check_definitions, check_mcap, check_ros1
from stereo_slam_env.files.opening import MOST_UNPACKED, open_regular, read_bytes, require_bounded_zstd, zstandard
from stereo_slam_env.files.yaml_files import parse_yaml

MOST_TOPICS = 5_000
MOST_GROWTH = 100
"""A packed file may unpack to so many times its size, or to `MOST_UNPACKED`."""
_MOST_METADATA = 5_000_000
_MAGIC_SQLITE, _MAGIC_MCAP, _MAGIC_ROS1 = b"SQLite format 3\0", b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n"
_STEPS = 1_000_000
"""Steps of the database between two looks at their number; a row takes a few."""
_INFORMATION = "rosbag2_bagfile_information"
_PIECE = 1 << 20


@contextmanager
def open_bag(path: Path) -> Iterator[Any]:
    """The reader of `rosbags` for a bag that was counted.

    Raises
    ------
    ValueError
        Too much is in it, or what no bag needs: one line.
    Exception
        Of the libraries that unpack and read it, where it is damaged.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with ExitStack() as stack:
        place = _checked_folder(path, stack) if path.is_dir() else path
        if place == path and path.is_file():
            _check_file(path)
        reader: Any = AnyReader([place], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        reader.readers = [_Counted(one, path) for one in reader.readers]
        yield stack.enter_context(reader)


class _Counted:
    """A reader of a file whose topics and definitions are looked at before types are made of them."""

    def __init__(self, reader: Any, path: Path) -> None:
        self._reader, self._path = reader, path

    def __enter__(self) -> Any:
        entered = self._reader.__enter__()
        try:
            connections = self._reader.connections
            if len(connections) > MOST_TOPICS:
                raise BagTooLarge(f"{self._path} has {len(connections)} topics: more than {MOST_TOPICS} are refused")
            check_definitions(self._path, [(c.msgtype, str(c.msgdef.data)) for c in connections])
        except BaseException:
            self._reader.__exit__(None, None, None)
            raise
        return entered

    def __exit__(self, *about: Any) -> Any:
        return self._reader.__exit__(*about)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)


def _checked_folder(folder: Path, stack: ExitStack) -> Path:
    """The folder of a bag, or one for the time being with its files unpacked."""
    file = folder / "metadata.yaml"
    try:
        content = parse_yaml(read_bytes(file, most_bytes=_MOST_METADATA, inside=folder).decode())
        about = content[_INFORMATION]
        names = [Path(str(name)).name for name in about["relative_file_paths"]]
        topics, mode = len(about["topics_with_message_count"]), str(about.get("compression_mode") or "none").lower()
    except FileNotFoundError:
        raise
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        raise ValueError(f"{file} is no description of a bag ({first_line(error)}): copy it again") from error
    if topics > MOST_TOPICS or len(names) > MOST_TOPICS:
        raise BagTooLarge(f"{file} has {topics} topics in {len(names)} files: more than {MOST_TOPICS} are refused")
    for topic in about["topics_with_message_count"]:
        _check_qos(file, topic["topic_metadata"].get("offered_qos_profiles"))
    if mode != "file":
        for name in names:
            _check_file(folder / name, inside=folder, packed_messages=mode == "message")
        return folder
    scratch = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="stereo-slam-bag-")))
    for name in names:
        _unpack(folder / name, scratch / Path(name).stem, inside=folder)
        _check_file(scratch / Path(name).stem)
    about |= {
        "compression_mode": "none",
        "compression_format": "",
        "relative_file_paths": [Path(n).stem for n in names],
    }
    (scratch / "metadata.yaml").write_text(json.dumps(content, default=str))
    return scratch


def _unpack(packed: Path, out: Path, *, inside: Path) -> None:
    """Unpack a file packed by Zstandard, up to a limit."""
    with ExitStack() as stack:
        stream, written = stack.enter_context(open_regular(packed, inside=inside)), stack.enter_context(out.open("xb"))
        size = stream.seek(0, 2)
        stream.seek(0)
        unpacked = stack.enter_context(zstandard().open(stream, "rb"))
        limit = max(MOST_UNPACKED, MOST_GROWTH * size)
        count = 0
        while piece := unpacked.read(_PIECE):
            count += len(piece)
            if count > limit:
                raise BagTooLarge(f"{packed} would unpack to more than {limit} bytes, which is refused")
            written.write(piece)


def _check_file(path: Path, *, inside: Path | None = None, packed_messages: bool = False) -> None:
    """Raise a `ValueError` for a file of a bag that holds too much; what is damaged is left to its reader."""
    with open_regular(path, inside=inside, most_bytes=1 << 62) as stream:
        magic = stream.read(16)
        if magic.startswith(_MAGIC_MCAP):
            check_mcap(path, stream, most_topics=MOST_TOPICS, check_qos=_check_qos, packed_messages=packed_messages)
        elif magic.startswith(_MAGIC_ROS1):
            check_ros1(path, stream, most_topics=MOST_TOPICS)
        elif magic == _MAGIC_SQLITE:
            _check_database(path, _size(stream), packed_messages=packed_messages)


def _size(stream: BinaryIO) -> int:
    return stream.seek(0, 2)


def _check_qos(path: Path, text: object) -> None:
    """Raise a `ValueError` where the profile of a topic, YAML in a text, is none that is read."""
    if isinstance(text, str) and text:
        try:
            parse_yaml(text)
        except ValueError as error:
            raise ValueError(
                f"{path} has a topic with a damaged quality of service ({error}): copy it again"
            ) from error


# ---- databases -------------------------------------------------------------------------------------------------------


def _check_database(path: Path, size: int, *, packed_messages: bool) -> None:
    """Raise a `ValueError` for a database that has anything but tables and indices, or no end."""
    steps = 0

    def count() -> bool:
        nonlocal steps
        steps += _STEPS
        return steps > 10 * _STEPS + size  # a row has ten bytes and more, and takes fewer steps

    uri = f"file:{quote(str(path.absolute()))}?mode=ro&immutable=1"
    try:
        with closing(sqlite3.connect(uri, uri=True)) as database:
            database.set_progress_handler(count, _STEPS)
            _check_schema(path, database)
            for text, *_ in _rows_of(database, "topics", "offered_qos_profiles"):
                _check_qos(path, text)
            database.execute("SELECT count(topic_id) FROM messages NOT INDEXED").fetchone()
            database.execute("SELECT count(timestamp) FROM messages").fetchone()
            if packed_messages:
                for (data,) in database.execute("SELECT data FROM messages"):
                    require_bounded_zstd(path, data)
    except sqlite3.OperationalError as error:
        if "interrupted" in str(error):
            raise BagTooLarge(f"{path} has more rows than it can hold: it is damaged, copy it again") from error
        raise ValueError(f"{path} is damaged, or no bag ({first_line(error)}): copy it again") from error
    except sqlite3.Error as error:
        raise ValueError(f"{path} is damaged, or no bag ({first_line(error)}): copy it again") from error


def _check_schema(path: Path, database: sqlite3.Connection) -> None:
    """Views, triggers and virtual tables run what their maker wrote; computed columns as well."""
    schema = database.execute("SELECT type, name, sql FROM sqlite_master LIMIT 200").fetchall()
    if len(schema) == 200:
        raise BagTooLarge(f"{path} has 200 tables and more, which no bag has")
    for kind, name, sql in schema:
        text = " ".join(str(sql or "").upper().split())
        if kind not in ("table", "index") or text.startswith("CREATE VIRTUAL"):
            raise ValueError(f"{path} has a {kind}, {str(name)[:50]!r}, which no bag needs: convert it by ROS")
        if kind == "table":
            columns = database.execute(f"PRAGMA table_xinfo({json.dumps(str(name))})").fetchall()
            if any(column[6] for column in columns):
                raise ValueError(f"{path} has computed columns, which no bag needs: convert it with the tools of ROS")
    for table in ("topics", "message_definitions"):
        (count,) = next(iter(_rows_of(database, table, "count(*)")), (0,))
        if count > MOST_TOPICS:
            raise BagTooLarge(f"{path} has {count} {table.replace('_', ' ')}: more than {MOST_TOPICS} are refused")


def _rows_of(database: sqlite3.Connection, table: str, column: str) -> list[tuple[Any, ...]]:
    """Rows of a column that older bags have not; none then."""
    names = {row[1] for row in database.execute(f"PRAGMA table_info({table})")}
    if not names or not (column in names or "(" in column):
        return []
    rows: list[tuple[Any, ...]] = database.execute(f"SELECT {column} FROM {table} LIMIT {MOST_TOPICS + 1}").fetchall()
    return rows
