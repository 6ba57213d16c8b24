"""Numbers of a scenario file that no machine could serve are refused in a line, before any work is done (0.2 s)."""

import pytest

from stereo_slam_env.benchmark.scenarios.study import load_study
from stereo_slam_env.cli.app import main

HEAD = 'name = "huge"\nkind = "reference"\n'
SHORT = 'options = { name = "short_turn" }\n'
STREET = 'name = "huge"\nkind = "street"\n'


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (HEAD + SHORT + "seeds = [18446744073709551616]", r"seeds\[0\] must be a whole number <= 9223372036854775807"),
        (HEAD + SHORT + "seeds = [9223372036854775808]", r"seeds\[0\] must be .*9\.?22337"),
        (HEAD + SHORT + f"seeds = [{10**400}]", r"seeds\[0\] must be .*, got 10000000000000000000.*\.\.\."),
        (HEAD + SHORT + "seeds = [-1]", r"seeds\[0\] must be .* >= 0, got -1"),
        (HEAD + 'options = { name = "short_turn", sigma = 1e308 }', r"options.sigma must be .* 1e\+06, got 1e\+308"),
        (HEAD + 'options = { name = "short_turn", sigma = nan }', "must consist of JSON values"),
        (
            HEAD + 'options = { name = "long_drive", landmarks = 1000000000 }',
            r"options.landmarks must be .* 10000, got 1",
        ),
        (STREET + "options = { max_landmarks = 1000000000 }", r"options.max_landmarks must be .* 10000, got 1e\+09"),
        (STREET + "options = { rig = { width = 1000000000 } }", r"options.rig.width must be .* 20000, got 1e\+09"),
        (HEAD + SHORT + "noise = { independent_pixels = 1e308 }", r"noise.independent_pixels must be .*got 1e\+308"),
        (HEAD + SHORT + "noise = { diagonal = [1, 1, 1e308] }", r"noise.diagonal\[2\] must be .*got 1e\+308"),
        (HEAD + SHORT + "motion = { sigma_acceleration = 1e308 }", r"motion.sigma_acceleration must be .*got 1e\+308"),
        (HEAD + SHORT + "frames = 1000000000", r"frames must be a whole number <= 1000000, got 1000000000"),
        (HEAD + SHORT + "frame_time_limit = 1e300", r"frame_time_limit must be a number <= 1000000.0, got 1e\+300"),
        (
            HEAD + SHORT + 'corruptions = [{ kind = "latency", frames = 1000000000 }]',
            r"corruptions\[0\].frames must be",
        ),
        (
            HEAD + SHORT + "corruptions = [" + 20_000 * '{ kind = "latency", frames = 1 },' + "]",
            r"length <= 100, .*\.\.",
        ),
        (
            HEAD + SHORT + '[[filters]]\nname = "inverse-depth"\noptions = { iterations = 1000000000 }',
            r"options of inverse-depth.iterations must be a number of at most 1000, got 1e\+09",
        ),
    ],
)
def test_key_value_and_bound_are_named(text, complaint, tmp_path, capsys):
    path = tmp_path / "huge.toml"
    path.write_text(text + "\n")
    with pytest.raises(ValueError, match=complaint) as caught:
        load_study(path)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400
    assert main(["bench", "--scenario", str(path), "--out", str(tmp_path / "out")]) == 2
    assert capsys.readouterr().err.startswith("error: scenario file")
    assert not (tmp_path / "out").exists()


def test_the_largest_seed_that_tables_hold_is_taken(tmp_path):
    (tmp_path / "s.toml").write_text(HEAD + SHORT + "seeds = [9223372036854775807]\n")
    assert load_study(tmp_path / "s.toml").only_scenario().seeds == (2**63 - 1,)
