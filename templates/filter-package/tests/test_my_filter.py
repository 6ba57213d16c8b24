"""The contract, and the figures that this filter is meant to have."""

from filters import available_filters, parametrize_with_checks
from my_slam_filter import MyFilter


@parametrize_with_checks([MyFilter])
def test_the_contract_of_a_filter_is_kept(filter, check):
    """One case for each check; the name of a case says which."""
    check(filter)


def test_the_bench_knows_it_by_name():
    assert "my-filter" in available_filters()


def test_it_is_consistent_and_not_worse_than_the_papers(slam_bench):
    """The fixture comes with stereo-slam-env."""
    result = slam_bench(MyFilter, against="inverse-depth")
    result.assert_not_worse(percent=5)
    result.assert_consistent()
