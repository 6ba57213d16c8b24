"""Which changes of the code make kept results void, and what it costs to know (5 s)."""

import shutil
import time
from functools import partial

import pytest

from stereo_slam_env.benchmark.storage import code_identity, store
from stereo_slam_env.benchmark.storage.code_identity import NO_RESULT, ROOT, code_digest

from .test_store import fill

KALMAN = "filters/engine/kalman.py"


@pytest.fixture(scope="module")
def known(tmp_path_factory):
    """Both packages, whose digest has been asked for once."""
    root = tmp_path_factory.mktemp("known")
    for package in ("filters", "stereo_slam_env"):
        shutil.copytree(ROOT / package, root / package, ignore=shutil.ignore_patterns("__pycache__"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.dont_write_bytecode", False)
        digest(root)
    return root


@pytest.fixture
def copy(known, tmp_path, monkeypatch):
    """Both packages, to be edited."""
    monkeypatch.setattr("sys.dont_write_bytecode", False)
    return shutil.copytree(known, tmp_path / "copy")


def digest(root, **options):
    return code_digest.__wrapped__(root=root, **options)


def edit(path, old, new):
    text = path.read_text(encoding="utf-8")
    assert old in text
    path.write_text(text.replace(old, new, 1), encoding="utf-8")


def test_a_copy_elsewhere_is_the_same_code(copy):
    assert digest(copy) == code_digest()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("squared_limit = 1.5", "squared_limit   =  1.5  # a remark"),
        ("Gates.", "Gates, said otherwise."),
        ('"""How far."""\n', '"""How far."""\n    """And why."""\n'),
        ("(a, b)", "(\n        a,\n        b,\n    )"),
    ],
)
def test_docstrings_comments_and_formatting_change_nothing(copy, old, new):
    (copy / "filters" / "gates.py").write_text(
        '"""Gates."""\n\nsquared_limit = 1.5\n\n\ndef far(a, b):\n    """How far."""\n    return max((a, b))\n'
    )
    before = digest(copy)
    edit(copy / "filters" / "gates.py", old, new)
    assert digest(copy) == before


@pytest.mark.parametrize(
    ("file", "old", "new"),
    [
        ("stereo_slam_env/world/physics.py", "_SURFACE_GAP = 0.05", "_SURFACE_GAP = 0.06"),
        ("filters/catalogue/presets.py", '="shared-anchor"', '="inverse-depth"'),
        (KALMAN, "import numpy as np\n", "import numpy as np\n\nnp.seterr(all='raise')\n"),
    ],
)
def test_a_number_a_string_and_a_statement_change_it(copy, file, old, new):
    before = digest(copy)
    edit(copy / file, old, new)
    assert digest(copy) != before


def test_a_new_module_and_a_trained_network_count(copy):
    digests = [digest(copy)]
    (copy / "filters" / "another.py").write_text("x = 1\n")
    digests.append(digest(copy))
    (network,) = (copy / "stereo_slam_env").rglob("*.npz")
    network.write_bytes(network.read_bytes() + b"\0")
    assert len({*digests, digest(copy)}) == 3


def test_what_makes_no_result_may_change(copy):
    before = digest(copy), digest(copy, without=())
    for path in [*(copy / "stereo_slam_env" / "viewer").glob("*.py"), *(copy / "stereo_slam_env").glob("cli*.py")]:
        path.write_text("x = 1\n")
    after = digest(copy), digest(copy, without=())
    assert after[0] == before[0]
    assert after[1] != before[1]


def test_every_place_that_makes_no_result_is_there():
    files = [path.relative_to(ROOT).as_posix() for path in ROOT.glob("*/**/*.py")]
    assert [place for place in NO_RESULT if not any(name.startswith(place) for name in files)] == []


def test_a_run_is_kept_when_a_docstring_changes_and_not_when_a_number_does(copy, tmp_path, monkeypatch):
    monkeypatch.setattr(store, "code_digest", partial(digest, copy))
    finished = fill(tmp_path / "out")
    edit(copy / KALMAN, '"""', '"""Edited. ')
    assert finished.missing() == []
    edit(copy / "stereo_slam_env/world/physics.py", "_SURFACE_GAP = 0.05", "_SURFACE_GAP = 0.06")
    assert len(finished.missing()) == 2


def test_it_is_known_at_once_the_second_time(copy):
    first = digest(copy)
    began = time.process_time()
    assert digest(copy) == first
    assert time.process_time() - began < 0.1
    parsed = []
    edit(copy / KALMAN, '"""', '"""Edited. ')
    with pytest.MonkeyPatch.context() as patch:
        meaning = code_identity._meaning
        patch.setattr(code_identity, "_meaning", lambda name, source: parsed.append(name) or meaning(name, source))
        assert digest(copy) == first
    assert parsed == [KALMAN]


@pytest.mark.parametrize("content", [b"", b"{", b"\xff"])
def test_a_damaged_memory_is_made_again(copy, content):
    first = digest(copy)
    (memory,) = (copy / "filters" / "__pycache__").glob("code-*.json")
    memory.write_bytes(content)
    assert digest(copy) == first
    assert memory.stat().st_size > 1000


def test_nothing_is_written_where_python_may_not_write_either(copy, monkeypatch):
    monkeypatch.setattr("sys.dont_write_bytecode", True)
    shutil.rmtree(copy / "filters" / "__pycache__")
    assert digest(copy) == code_digest()
    assert not (copy / "filters" / "__pycache__").exists()
