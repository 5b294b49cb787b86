"""TOML text of trees of plain values: the reader returns what was written."""

import tomllib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyherd.datasets import scenario_names, scenario_text, toml_text

TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=8)
VALUES = st.recursive(
    st.booleans() | st.integers(-(2**63), 2**63 - 1) | st.floats(allow_nan=False) | TEXTS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(TEXTS, inner, max_size=3),
    max_leaves=8,
)


@given(tree=st.dictionaries(TEXTS, VALUES, max_size=4))
def test_written_tree_is_read_back_equal(tree):
    assert tomllib.loads(toml_text(tree)) == tree


@pytest.mark.parametrize("name", scenario_names())
def test_built_in_scenario_is_read_back_equal(name):
    tree = tomllib.loads(scenario_text(name))
    assert tomllib.loads(toml_text(tree)) == tree


def test_value_of_none_is_left_out():
    assert toml_text({"a": None, "b": {"c": None, "d": [{"e": None}]}}) == "\n[b]\nd = [{  }]\n"
