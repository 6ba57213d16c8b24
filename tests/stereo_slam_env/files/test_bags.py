"""Bags that would fill memory, disk or time are refused before they are unpacked; healthy ones are read (15 s)."""

from __future__ import annotations

import bz2
import json
import sqlite3
import struct
import time

import numpy as np
import pytest

pytest.importorskip("rosbags", reason="needs the extra bags")

from fuzz.harness import limited_memory
from stereo_slam_env.files.bag_records import check_definitions
from stereo_slam_env.files.opening import Unbounded, lz4_bound, zstandard, zstd_bound
from stereo_slam_env.recording.trajectory_bags import opened_bag
from stereo_slam_env.recording.trajectory_files import load_trajectory

POSE = "geometry_msgs/msg/PoseStamped"
MOST_SECONDS = 20.0
MCAP = b"\x89MCAP0\r\n"


def healthy(folder, *, plugin="mcap", mode=None, count=20):
    """A bag of poses, as `rosbags` writes one."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    kinds = types.types
    opened = Writer(folder, version=8, storage_plugin=StoragePlugin[plugin.upper()])
    if mode:
        opened.set_compression(CompressionMode[mode], CompressionFormat.ZSTD)
    with opened as writer:
        connection = writer.add_connection("/pose", POSE, typestore=types)
        for k in range(count):
            stamp = kinds["builtin_interfaces/msg/Time"](sec=k, nanosec=0)
            pose = kinds["geometry_msgs/msg/Pose"](
                kinds["geometry_msgs/msg/Point"](0.1 * k, 0.0, 1.0 * k),
                kinds["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
            )
            message = kinds[POSE](kinds["std_msgs/msg/Header"](stamp, "w"), pose)
            writer.write(connection, k * 10**9, types.serialize_cdr(message, POSE))
    return folder


def database_of(folder):
    return next(folder.glob("*.db3"))


def changed(folder, *statements):
    with sqlite3.connect(database_of(folder)) as database:
        for statement in statements:
            database.execute(statement)
    database.close()
    return folder


def record(kind, content):
    return struct.pack("<BQ", kind, len(content)) + content


def text(value):
    value = value if isinstance(value, bytes) else value.encode()
    return struct.pack("<I", len(value)) + value


def schema(number=1, name=POSE, definition="float64 x\n"):
    return record(3, struct.pack("<H", number) + text(name) + text("ros2msg") + text(definition))


def channel(number=1, topic="/pose", metadata=b""):
    return record(4, struct.pack("<HH", number, 1) + text(topic) + text("cdr") + text(metadata))


def chunk(content, *, packing="", stated=None, start=0, end=9):
    head = struct.pack("<QQQI", start, end, len(content) if stated is None else stated, 0) + text(packing)
    return record(6, head + struct.pack("<Q", len(content)) + content)


def index(at, whole, content, *, packing="", stated=None, start=0, end=9):
    times = struct.pack("<QQQQ", start, end, at, len(whole)) + text(b"") + struct.pack("<Q", 0) + text(packing)
    return record(8, times + struct.pack("<QQ", len(content), len(content) if stated is None else stated))


def mcap(path, data, summary=b"", *, start=None):
    body = MCAP + record(1, text("ros2") + text("test")) + data
    begin = (len(body) if summary else 0) if start is None else start
    path.write_bytes(body + summary + record(2, struct.pack("<QQI", begin, 0, 0)) + MCAP)
    return path


FIRST = len(MCAP + record(1, text("ros2") + text("test")))


def repeated(size, stated=None):
    """A frame of Zstandard of a few bytes that unpacks to a size: blocks that say how often a byte is repeated."""
    block = ((1 << 17) << 3 | 1 << 1).to_bytes(3, "little") + b"\0"
    last = ((1 << 17) << 3 | 1 << 1 | 1).to_bytes(3, "little") + b"\0"
    head = b"\x28\xb5\x2f\xfd" + (b"\xc0\x38" + struct.pack("<Q", stated) if stated else b"\x00\x38")
    return head + (size // (1 << 17) - 1) * block + last


def lz4_of(size):
    import lz4.frame

    return lz4.frame.compress(bytes(size), store_size=False)


def one_chunk(path, content, packing, stated):
    whole = chunk(content, packing=packing, stated=stated)
    return mcap(path, schema() + channel() + whole, schema() + channel() + index(
        FIRST + len(schema() + channel()), whole, content, packing=packing, stated=stated))  # fmt: skip


def without_summary(path, content, packing, stated):
    return mcap(path, schema() + channel() + chunk(content, packing=packing, stated=stated))


def many_chunks(path):
    """All of one time, each small."""
    content = repeated(200_000_000)
    wholes = chunk(content, packing="zstd", stated=200_000_000)
    begin = FIRST + len(schema() + channel())
    summary = b"".join(
        index(begin + k * len(wholes), wholes, content, packing="zstd", stated=200_000_000) for k in range(9)
    )
    return mcap(path, schema() + channel() + 9 * wholes, schema() + channel() + summary)


def hidden_chunk(path):
    """An index that points into a message, where another chunk is."""
    inner = chunk(repeated(8_000_000_000), packing="zstd", stated=1000)
    message = record(5, bytes(22) + inner)
    at = FIRST + len(schema() + channel()) + 9 + 22
    return mcap(path, schema() + channel() + message, schema() + channel() + index(
        at, inner, repeated(8_000_000_000), packing="zstd", stated=1000))  # fmt: skip


def hidden_summary(path):
    data = schema() + channel() + record(5, bytes(22) + schema() + channel())
    return mcap(path, data, schema(), start=FIRST + len(schema() + channel()) + 9 + 22)


YAML_BOMB = "a: &a [x,x,x,x,x,x,x,x,x]\n" + "".join(
    f"{chr(98 + k)}: &{chr(98 + k)} [{','.join(9 * ['*' + chr(97 + k)])}]\n" for k in range(8)
)
MERGES = "m0: &m0 {a: 1}\n" + "".join(f"m{k + 1}: &m{k + 1} {{<<: [*m{k}, *m{k}]}}\n" for k in range(40))


def in_folder(path, content):
    healthy(path)
    (path / "metadata.yaml").write_text(content((path / "metadata.yaml").read_text()))
    return path


def many_topics(content):
    about = json.loads(json.dumps(__import__("yaml").safe_load(content), default=str))
    topics = about["rosbag2_bagfile_information"]["topics_with_message_count"]
    about["rosbag2_bagfile_information"]["topics_with_message_count"] = 65_000 * topics
    return json.dumps(about)


def packed_file(path):
    healthy(path, plugin="sqlite3", mode="FILE")
    packed = next(path.glob("*.zstd"))
    packed.write_bytes(repeated(20_000_000_000))
    return path


def packed_message(path):
    healthy(path, plugin="sqlite3", mode="MESSAGE")
    with sqlite3.connect(database_of(path)) as database:
        database.execute("UPDATE messages SET data = ?", (repeated(8_000_000_000),))
    database.close()
    return path


def packed_message_of_mcap(path):
    healthy(path, plugin="mcap", mode="MESSAGE")
    file = next(path.glob("*.mcap"))
    mcap(file, schema() + channel() + record(5, struct.pack("<HIQQ", 1, 0, 0, 0) + repeated(8_000_000_000)))
    return path


ENDLESS = "WITH RECURSIVE n(x) AS (SELECT 1 UNION ALL SELECT x + 1 FROM n) SELECT x"


def view(path):
    selected = "id, 1 AS topic_id, x AS timestamp, x AS data"
    statements = ("DROP TABLE messages", f"CREATE VIEW messages AS {ENDLESS} AS {selected} FROM n")
    return changed(healthy(path, plugin="sqlite3"), *statements)


def view_beside(path):
    return changed(healthy(path, plugin="sqlite3"), f"CREATE VIEW more AS {ENDLESS} FROM n")


def trigger(path):
    body = "CREATE TRIGGER t AFTER INSERT ON messages BEGIN DELETE FROM topics; END"
    return changed(healthy(path, plugin="sqlite3"), body)


def virtual(path):
    return changed(healthy(path, plugin="sqlite3"), "CREATE VIRTUAL TABLE v USING fts5(a)")


def computed(path):
    columns = "id INTEGER PRIMARY KEY, topic_id INTEGER, timestamp INTEGER, data BLOB AS (zeroblob(900000000))"
    made = f"CREATE TABLE messages({columns})"
    return changed(healthy(path, plugin="sqlite3"), "DROP TABLE messages", made)


def topics_of_database(path):
    numbers = "WITH RECURSIVE n(x) AS (SELECT 9 UNION ALL SELECT x + 1 FROM n WHERE x < 65000)"
    made = f"{numbers} INSERT INTO topics SELECT x, 't' || x, '{POSE}', 'cdr', '', '' FROM n"
    return changed(healthy(path, plugin="sqlite3"), made)


def qos_of_database(path):
    healthy(path, plugin="sqlite3")
    with sqlite3.connect(database_of(path)) as database:
        database.execute("UPDATE topics SET offered_qos_profiles = ?", (MERGES,))
    database.close()
    return path


def endless_tree(path):
    """Every child of a page is the next page, again and again: 200 to the power of six rows in 30 kB."""
    healthy(path, plugin="sqlite3", count=3000)
    file = database_of(path)
    with sqlite3.connect(file) as database:
        database.execute("DROP INDEX timestamp_idx")
        (root,) = database.execute("SELECT rootpage FROM sqlite_master WHERE name = 'messages'").fetchone()
    database.close()
    content = bytearray(file.read_bytes())
    size = struct.unpack_from(">H", content, 16)[0]
    page = content[(root - 1) * size : root * size]
    assert page[0] == 5
    cells = struct.unpack_from(">H", page, 3)[0]
    pages = len(content) // size
    chain = [root, *range(pages + 1, pages + 6)]
    (leaf,) = struct.unpack_from(">I", page, struct.unpack_from(">H", page, 12)[0])
    content += bytes(5 * size)
    for here, following in zip(chain, [*chain[1:], leaf], strict=True):
        copy = bytearray(page)
        for k in range(cells):
            struct.pack_into(">I", copy, struct.unpack_from(">H", copy, 12 + 2 * k)[0], following)
        struct.pack_into(">I", copy, 8, following)
        content[(here - 1) * size : here * size] = copy
    struct.pack_into(">I", content, 28, len(content) // size)
    file.write_bytes(content)
    return path


def field(name, value):
    return struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value


def ros1(path, content, packing, stated, *, definition="float64 x\n"):
    chunk_record = b"".join(
        (field("op", b"\5"), field("compression", packing), field("size", struct.pack("<I", stated)))
    )
    head_size = 4096
    at = 13 + head_size
    body = struct.pack("<I", len(chunk_record)) + chunk_record + struct.pack("<I", len(content)) + content
    connection = field("op", b"\7") + field("conn", struct.pack("<I", 0)) + field("topic", b"/pose")
    about = (
        field("topic", b"/pose")
        + field("type", b"geometry_msgs/PoseStamped")
        + field("md5sum", 32 * b"0")
        + field("message_definition", definition.encode())
    )
    tail = struct.pack("<I", len(connection)) + connection + struct.pack("<I", len(about)) + about
    info = b"".join(
        (
            field("op", b"\6"),
            field("ver", struct.pack("<I", 1)),
            field("chunk_pos", struct.pack("<Q", at)),
            field("start_time", bytes(8)),
            field("end_time", bytes(8)),
            field("count", struct.pack("<I", 1)),
        )
    )
    tail += struct.pack("<I", len(info)) + info + struct.pack("<III", 8, 0, 1)
    header = (
        field("op", b"\3")
        + field("index_pos", struct.pack("<Q", at + len(body)))
        + field("conn_count", struct.pack("<I", 1))
        + field("chunk_count", struct.pack("<I", 1))
    )
    padding = head_size - 8 - len(header)
    path.write_bytes(
        b"#ROSBAG V2.0\n"
        + struct.pack("<I", len(header))
        + header
        + struct.pack("<I", padding)
        + padding * b" "
        + body
        + tail
    )
    return path


def bomb_of_bz2():
    return bz2.compress(bytes(100_000_000), 9)


GB8 = 8_000_000_000
STATES_MUCH = b"\x04\x22\x4d\x18\x68\x40" + struct.pack("<Q", GB8) + bytes(5)
EMPTY = f"E[] x\n{80 * '='}\nMSG: geometry_msgs/E\n# none\n"


def topics(count):
    return b"".join(channel(k, f"/t{k}") for k in range(count))


def with_qos(profile):
    return schema() + channel(1, "/pose", text("offered_qos_profiles") + text(profile))


def defined(path, definition):
    return mcap(path / "a.mcap", schema(1, POSE, definition) + channel())


def with_deep_entry(content):
    return content.replace("version: ", f"other: 1{100 * ':59'}\n  version: {99 * '['}")


BOMBS = {
    "zstd chunk": lambda p: one_chunk(p / "a.mcap", repeated(GB8), "zstd", GB8),
    "zstd chunk that states little": lambda p: one_chunk(p / "a.mcap", repeated(GB8), "zstd", 1000),
    "zstd chunk with a size": lambda p: one_chunk(p / "a.mcap", repeated(GB8, stated=GB8), "zstd", 1000),
    "zstd chunk of two frames": lambda p: one_chunk(p / "a.mcap", repeated(1 << 17) + repeated(GB8), "zstd", 1000),
    "zstd chunk without summary": lambda p: without_summary(p / "a.mcap", repeated(GB8), "zstd", 1000),
    "lz4 chunk": lambda p: one_chunk(p / "a.mcap", lz4_of(600_000_000), "lz4", 1000),
    "lz4 chunk that states much": lambda p: one_chunk(p / "a.mcap", STATES_MUCH, "lz4", 10),
    "many chunks at one time": lambda p: many_chunks(p / "a.mcap"),
    "a chunk in a message": lambda p: hidden_chunk(p / "a.mcap"),
    "a summary in a message": lambda p: hidden_summary(p / "a.mcap"),
    "zstd file": lambda p: packed_file(p / "bag"),
    "zstd message": lambda p: packed_message(p / "bag"),
    "zstd message in MCAP": lambda p: packed_message_of_mcap(p / "bag"),
    "anchors": lambda p: in_folder(p / "bag", lambda content: YAML_BOMB + content),
    "merges": lambda p: in_folder(p / "bag", lambda content: MERGES + content),
    "colons": lambda p: in_folder(p / "bag", with_deep_entry),
    "65,000 topics in metadata": lambda p: in_folder(p / "bag", many_topics),
    "65,000 topics": lambda p: mcap(p / "a.mcap", schema() + topics(65_000)),
    "65,000 topics in a summary": lambda p: mcap(p / "a.mcap", schema(), schema() + topics(65_000)),
    "merges of a topic": lambda p: mcap(p / "a.mcap", with_qos(MERGES)),
    "merges of a topic in a chunk": lambda p: mcap(p / "a.mcap", chunk(with_qos(MERGES))),
    "texts": lambda p: defined(p, "string[2000000000] x\n"),
    "texts in a chunk": lambda p: mcap(p / "a.mcap", chunk(schema(1, POSE, "string[2000000] x\n") + channel())),
    "entries": lambda p: defined(p, "\n".join(f"string[500] x{k}" for k in range(100))),
    "fields": lambda p: defined(p, "".join(f"float64 x{k}\n" for k in range(30_000))),
    "a long definition": lambda p: defined(p, "# x\n" * 1_000_000),
    "nothing, four billion times": lambda p: defined(p, EMPTY),
    "an endless view": lambda p: view(p / "bag"),
    "a view": lambda p: view_beside(p / "bag"),
    "a trigger": lambda p: trigger(p / "bag"),
    "a virtual table": lambda p: virtual(p / "bag"),
    "computed columns": lambda p: computed(p / "bag"),
    "65,000 topics in a database": lambda p: topics_of_database(p / "bag"),
    "merges of a topic in a database": lambda p: qos_of_database(p / "bag"),
    "a tree without end": lambda p: endless_tree(p / "bag"),
    "bz2 chunk": lambda p: ros1(p / "a.bag", bomb_of_bz2(), b"bz2", 1000),
    "bz2 chunk that states much": lambda p: ros1(p / "a.bag", bomb_of_bz2(), b"bz2", 2_000_000_000),
    "lz4 chunk of ROS 1": lambda p: ros1(p / "a.bag", lz4_of(600_000_000), b"lz4", 1000),
    "texts of ROS 1": lambda p: ros1(p / "a.bag", b"", b"none", 0, definition="string[2000000000] x\n"),
}  # fmt: skip


def read_all(path):
    with opened_bag(path) as reader:
        for connection, _, raw in reader.messages():
            reader.deserialize(raw, connection.msgtype)


@pytest.mark.parametrize("name", BOMBS)
def test_a_bomb_is_refused_in_a_line_within_memory_and_time(name, tmp_path, monkeypatch):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(scratch))
    path = BOMBS[name](tmp_path)
    began = time.process_time()
    with limited_memory(1_500_000_000), pytest.raises(ValueError, match=r"\A[^\n]+\Z") as refused:
        read_all(path)
    assert path.name in str(refused.value)
    assert time.process_time() - began < MOST_SECONDS
    assert list(scratch.iterdir()) == []


@pytest.mark.parametrize("mode", [None, "FILE", "MESSAGE", "STORAGE"])
@pytest.mark.parametrize("plugin", ["mcap", "sqlite3"])
def test_healthy_bags_are_read(plugin, mode, tmp_path):
    if (plugin, mode) == ("sqlite3", "STORAGE"):
        pytest.skip("there is no such bag")
    folder = healthy(tmp_path / "bag", plugin=plugin, mode=mode)
    before = {path: path.read_bytes() for path in folder.iterdir()}
    found = load_trajectory(folder)
    np.testing.assert_allclose(found.positions[:, 2], np.arange(20.0))
    assert {path: path.read_bytes() for path in folder.iterdir()} == before
    if mode is None:
        file = next(path for path in folder.iterdir() if path.suffix in (".mcap", ".db3"))
        np.testing.assert_array_equal(load_trajectory(file).positions, found.positions)


@pytest.mark.parametrize("seed", range(4))
def test_bounds_of_packed_data_are_bounds(seed):
    import lz4.frame

    rng = np.random.default_rng(seed)
    zstd = zstandard()
    for size in (0, 1, 1000, 131_072, 131_073, 2_000_000):
        for content in (bytes(size), rng.bytes(size), bytes(rng.integers(0, 4, size, dtype=np.uint8))):
            assert size <= zstd_bound(zstd.compress(content)) <= size + 200_000
            assert size <= zstd_bound(zstd.compress(content) + zstd.compress(content[:7]))
            for checked in (False, True):
                packed = lz4.frame.compress(
                    content, content_checksum=checked, block_checksum=checked, store_size=checked
                )
                assert size <= lz4_bound(packed) <= max(255 * len(packed), size + 5_000_000)
    packed = zstd.compress(rng.bytes(1000))
    for wrong in (packed[:-3], packed[:3], b"x" * 9, packed + b"x"):
        with pytest.raises(Unbounded):
            zstd_bound(wrong)


def test_definitions_of_all_common_messages_pass(tmp_path):
    from rosbags.typesys import Stores, get_typestore

    for store in (Stores.ROS2_HUMBLE, Stores.ROS1_NOETIC):
        types = get_typestore(store)
        definitions = []
        for name in types.fielddefs:
            try:
                definitions.append((name, types.generate_msgdef(name)[0]))
            except Exception:  # a few cannot be written out
                continue
        assert len(definitions) > 100
        check_definitions(tmp_path, definitions)


def test_what_is_damaged_is_left_to_the_reader_that_says_so(tmp_path):
    folder = healthy(tmp_path / "bag")
    file = next(folder.glob("*.mcap"))
    whole = file.read_bytes()
    for content in (b"", whole[:50], whole[: len(whole) // 2], b"x" * 100, whole[:-1]):
        file.write_bytes(content)
        with pytest.raises(ValueError, match=r"\A[^\n]+\Z"), opened_bag(file):
            pass
