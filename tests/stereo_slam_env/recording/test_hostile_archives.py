"""An npz file from a stranger is read as arrays, or refused before it takes memory or runs anything."""

from __future__ import annotations

import io
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from stereo_slam_env.files.readers import MOST_BYTES, DamagedArchive, read_arrays

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
