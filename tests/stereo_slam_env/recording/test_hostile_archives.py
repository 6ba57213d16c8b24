"""An npz file from a stranger is read as arrays, or refused before it takes memory or runs anything."""

from __future__ import annotations

import io
import json
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from stereo_slam_env.benchmark.recordings.reference_problem import short_turn
from stereo_slam_env.files.readers import MOST_BYTES, DamagedArchive, read_arrays
from stereo_slam_env.recording.archive import load_recording, packed_recording

RNG = np.random.default_rng(0)
KINDS = {
    "columns first": np.asfortranarray(RNG.standard_normal((3, 4))),
    "nothing": np.zeros((0, 3)),
    "a number": np.array(1.5),
    "words": np.array("a line of JSON"),
    "flags": np.array([True, False]),
    "whole": np.arange(5, dtype=np.int64),
}


class Ran(RuntimeError):
    """The file made us do something."""


class Bomb:
    def __reduce__(self):
        return _ran, ()


def _ran():
    raise Ran


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def write(path: Path, content: bytes, method: int = zipfile.ZIP_DEFLATED) -> Path:
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("a.npy", content)
    return path


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_arrays_are_those_that_numpy_reads(save, tmp_path):
    save(tmp_path / "a.npz", **KINDS)
    read = read_arrays(tmp_path / "a.npz")
    with np.load(tmp_path / "a.npz", allow_pickle=False) as archive:
        assert list(read) == archive.files
        for name, array in read.items():
            np.testing.assert_array_equal(array, archive[name])
            assert (array.dtype, array.shape) == (archive[name].dtype, archive[name].shape)
            assert array.flags.writeable
            assert array.flags.f_contiguous == archive[name].flags.f_contiguous


def test_only_what_is_asked_for_is_read(tmp_path):
    np.savez(tmp_path / "a.npz", **KINDS)
    assert list(read_arrays(tmp_path / "a.npz", ["whole", "not there"])) == ["whole"]


def test_a_pickle_is_not_opened(tmp_path):
    np.savez(tmp_path / "a.npz", a=np.array([Bomb()], dtype=object))
    with pytest.raises(DamagedArchive, match="pickled objects"):
        read_arrays(tmp_path / "a.npz")


def test_a_bomb_is_refused_by_its_declared_size(tmp_path):
    path = write(tmp_path / "a.npz", npy(np.zeros(MOST_BYTES // 8 + 1)))
    assert path.stat().st_size < MOST_BYTES / 500
    tracemalloc.start()
    try:
        with pytest.raises(DamagedArchive, match="would unpack to"):
            read_arrays(path)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


def test_a_header_that_promises_too_much_allocates_nothing(tmp_path):
    promise = npy(np.zeros(8)).replace(b"(8,), ", b"(9999999999999,), ")
    tracemalloc.start()
    try:
        with pytest.raises(DamagedArchive):
            read_arrays(write(tmp_path / "a.npz", promise))
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize(
    "header", [b"(-8,), }", b"(8" + b",(8" * 500 + b"}", b"-" * 3000 + b"8,}", b"(8,), 'descr': '''"], ids=range(4)
)
def test_a_header_that_is_none_is_refused(header, tmp_path):
    with pytest.raises(DamagedArchive):
        read_arrays(write(tmp_path / "a.npz", npy(np.zeros(8)).replace(b"(8,), }", header)))


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2])
def test_compressions_that_numpy_does_not_write_are_refused(method, tmp_path):
    with pytest.raises(DamagedArchive, match="does not write"):
        read_arrays(write(tmp_path / "a.npz", npy(np.zeros(8)), method))


@pytest.mark.parametrize("content", [b"", b"PK", b"no archive", npy(np.zeros(3))])
def test_what_is_no_archive_is_refused(content, tmp_path):
    (tmp_path / "a.npz").write_bytes(content)
    with pytest.raises(DamagedArchive):
        read_arrays(tmp_path / "a.npz")


def test_a_changed_byte_is_seen(tmp_path):
    path = write(tmp_path / "a.npz", npy(np.arange(50.0)), zipfile.ZIP_STORED)
    data = bytearray(path.read_bytes())
    data[300] ^= 1
    path.write_bytes(bytes(data))
    with pytest.raises(DamagedArchive, match="CRC"):
        read_arrays(path)


def test_a_missing_file_is_said_to_be_missing(tmp_path):
    with pytest.raises(FileNotFoundError):
        read_arrays(tmp_path / "a.npz")


# --- recordings of the right form that hold what cannot be ------------------------------------------------------------


@pytest.fixture(scope="module")
def honest():
    """Arrays of a recording with truth, odometry and known landmarks."""
    return read_arrays(packed_recording(short_turn(seed=0, frames=4)))


def changed(arrays, name, change):
    arrays = {key: array.copy() for key, array in arrays.items()}
    arrays[name] = change(arrays[name])
    return arrays


def put(*at, value):
    def change(array):
        array[at] = value
        return array

    return change


def in_camera(name, value):
    def change(about):
        told = json.loads(str(about))
        told["camera"][name] = value
        return np.array(json.dumps(told))

    return change


@pytest.mark.parametrize(
    ("name", "change", "complaint"),
    [
        ("timestamps", put(1, value=np.nan), "array timestamps has NaN"),
        ("timestamps", lambda t: t[::-1].copy(), "array timestamps must ascend, and does not in frame 1"),
        ("timestamps", put(2, value=0.1), "array timestamps must ascend, and does not in frame 2"),
        ("timestamps", lambda t: t.astype(str), "array timestamps must hold numbers, got <U"),
        ("timestamps", put(3, value=1e30), r"array timestamps has .* beyond 1e\+12"),
        ("uvd", lambda uvd: uvd.astype(complex), "array uvd must hold numbers, got complex128"),
        ("uvd", put(0, 1, value=np.inf), "array uvd has NaN, infinity"),
        ("ids", lambda ids: ids.astype(float), "array ids must hold integers, got float64"),
        ("counts", lambda counts: counts * [-1, 1, 1, 1], "array counts must be >= 0"),
        ("has.truth", lambda has: has.astype(int), "array has.truth must hold truth values, got int64"),
        ("truth.orientation", put(2, value=0.0), "array truth.orientation must hold unit quaternions"),
        ("truth.position", put(1, 0, value=np.nan), "array truth.position has NaN"),
        ("truth.position", put(1, 1, value=1e30), r"array truth.position has .* beyond 1e\+12"),
        ("start.orientation", put(slice(None), value=0.0), "array start.orientation must hold unit quaternions"),
        ("landmarks.positions", put(0, 0, value=np.nan), "array landmarks.positions has NaN"),
        ("noise", put(0, 0, value=np.nan), "array noise has NaN"),
        ("about", in_camera("height", 1e30), r"height of the camera must be a whole number up to 100000, got 1e\+30"),
        ("about", in_camera("width", "640"), "width of the camera must be a whole number"),
        ("about", in_camera("fx", 10**400), "fx of the camera must be a number"),
        ("about", in_camera("baseline", None), "baseline of the camera must be a number"),
    ],
)
def test_a_recording_that_cannot_be_is_refused_and_the_part_named(honest, name, change, complaint, tmp_path):
    np.savez(tmp_path / "a.npz", **changed(honest, name, change))
    with pytest.raises(ValueError, match=rf"\A[^\n]*a\.npz is damaged \({complaint}[^\n]*\Z"):
        load_recording(tmp_path / "a.npz")


def test_the_honest_recording_is_read(honest, tmp_path):
    np.savez(tmp_path / "a.npz", **honest)
    assert len(load_recording(tmp_path / "a.npz")) == 4


@pytest.mark.filterwarnings("ignore:Duplicate name")
@pytest.mark.parametrize("second", ["uvd.npy", "uvd"])
def test_a_part_that_is_there_twice_is_refused(honest, second, tmp_path):
    np.savez(tmp_path / "a.npz", **honest)
    with zipfile.ZipFile(tmp_path / "a.npz", "a") as archive:
        archive.writestr(second, npy(honest["uvd"] + 1.0))
    with pytest.raises(ValueError, match=rf"a\.npz is damaged \(it holds {second} twice\)"):
        load_recording(tmp_path / "a.npz")


def test_a_table_of_contents_without_end_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        for number in range(70_000):
            archive.writestr(f"{number:0150d}", b"")
    with pytest.raises(DamagedArchive, match="its table of contents is longer than that of a recording"):
        read_arrays(tmp_path / "a.npz")


def test_a_giant_with_a_small_archive_at_its_end_may_not_unpack_to_its_multiple(tmp_path):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(MOST_BYTES + 1))
    with (tmp_path / "a.npz").open("wb") as file:
        file.seek(1_900_000_000)
        file.write(stream.getvalue())
    with pytest.raises(DamagedArchive, match="more than 256000000 are refused"):
        read_arrays(tmp_path / "a.npz")
