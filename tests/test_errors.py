"""Errors of several problems: their lines, their parts, and how they are joined."""

import pytest

from skyherd.errors import MAX_PROBLEMS, InputError, InputErrors, ProblemCollector, join_errors


def problem(number: int) -> InputError:
    return InputError(f"key {number}", "wrong", "right")


def test_one_problem_stays_an_error_of_one_line():
    error = join_errors([problem(1), problem(1)])
    assert type(error) is InputError
    assert error.lines == (str(error),) == ("key 1: wrong; right",)


def test_several_problems_have_a_line_each():
    error = join_errors([problem(1), join_errors([problem(2), problem(3)])])
    assert isinstance(error, InputErrors) and isinstance(error, ValueError)
    assert str(error).splitlines() == [f"key {number}: wrong; right" for number in (1, 2, 3)]
    assert (error.where, error.what, error.allowed) == ("key 1", "wrong", "right")
    assert error.exit_code == 2


@pytest.mark.parametrize(
    ("count", "more", "last"), [(12, 0, "and 2 more problems"), (11, 0, "and 1 more problem")]
)
def test_problems_beyond_the_limit_are_counted(count, more, last):
    error = join_errors([problem(number) for number in range(count)], more)
    assert len(error.lines) == MAX_PROBLEMS + 1
    assert error.lines[-1] == last


def test_count_of_further_problems_survives_joining():
    assert join_errors([InputErrors([problem(1)], 4), problem(2)]).lines[-1] == "and 4 more problems"


def test_place_is_put_before_each_problem():
    assert join_errors([problem(1), problem(2)]).within("file").lines[1] == "file: key 2: wrong; right"
    assert InputError("", "a", "b").within_key("k").where == "k"
    assert InputError("x", "a", "b").within_key("k").where == "k.x"


def test_collector_raises_all_that_it_caught():
    collector = ProblemCollector()
    collector.raise_all()
    for number in (1, 2):
        with collector.collecting():
            raise problem(number)
    with pytest.raises(KeyError), collector.collecting():
        raise KeyError("no problem of the input")
    with pytest.raises(InputErrors, match=r"key 1[^\n]*\nkey 2"):
        collector.raise_all()
