"""TOML files that would overload the parser's stack or time are refused before parsing."""

import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from skyherd.datasets import load_mission, scenario_names, scenario_text
from skyherd.datasets.configuration import toml_files
from skyherd.datasets.configuration.toml_files import MAX_LEVELS, depth, parse_toml
from skyherd.datasets.labelled.spec import load_spec
from skyherd.errors import InputError


def dots(count: int) -> str:
    return ".".join(["a"] * count) + " = 1\n"


ENDLESS = {
    "a key of 20,000 names": dots(20_000),
    "the same, spaced and quoted": " . ".join(['"a"', "'b'"] * 10_000) + " = 1\n",
    "in a table's name": f"[{'.'.join(['a'] * 20_000)}]\n",
    "3,000 lists": f"a = {'[' * 3000}{']' * 3000}\n",
    "3,000 tables": f"a = {'{a = ' * 3000}1{'}' * 3000}\n",
    "behind a string with a bracket": f'a = "]]]]"\nb = {"[" * 3000}{"]" * 3000}\n',
    "behind a string of many lines": f'a = """\\""" + """\n{dots(20_000)}',
    "an integer of 5,000 digits": f"a = {'9' * 5000}\n",
    "a list of 6 MB": f"a = [{'1,' * 3_000_000}]\n",
}


@pytest.mark.parametrize("text", ENDLESS.values(), ids=ENDLESS)
def test_it_is_refused_in_one_short_line_and_at_once(tmp_path, text):
    """The refusal takes a tenth of a second of processor time; the limit is 5 s."""
    path = tmp_path / "a.toml"
    path.write_text(text)
    began_s = time.process_time()
    for load in (load_mission, load_spec):
        with pytest.raises(InputError) as refused:
            load(str(path))
        assert len(str(refused.value)) < 500 and "\n" not in str(refused.value)
    assert time.process_time() - began_s < 5


@pytest.mark.parametrize("key", [dots(20_000)[:-5], "units." + "9" * 5000 + ".yaw_deg", "a" * 50_000])
def test_keys_of_set_are_refused_too(key):
    with pytest.raises(InputError) as refused:
        load_mission("star", [f"{key}=1"])
    assert len(str(refused.value)) < 500


@pytest.mark.parametrize("value", ["9" * 5000, "[" * 3000, "{a=" * 3000, "1e999", "x" * 100_000, "1\n[b]"])
@pytest.mark.parametrize("key", ["seed", "control.k", "name", "units.0.camera.size_px", "template.shape"])
def test_values_of_set_are_refused_too(key, value):
    with pytest.raises(InputError) as refused:
        load_mission("star", [f"{key}={value}"])
    assert len(str(refused.value)) < 500


def test_all_built_in_files_are_far_from_the_limits():
    texts = [scenario_text(name) for name in scenario_names()]
    assert max(map(depth, texts)) <= 6 < MAX_LEVELS
    assert max(map(len, texts)) < toml_files.MAX_BYTES / 20


def test_strings_and_comments_do_not_count():
    text = """
a = "[[[[{{{{"
b = '''[[[
[['''
# [[[[ a.b.c.d.e.f
c = \"\"\"a.b.c.d.e.f [[ \\\"\"\" ]]\"\"\"
d = 1.5
"""
    assert depth(text) == 2
    assert parse_toml(text, "a", "b")["c"].startswith("a.b")


trees = st.recursive(
    st.integers() | st.text(st.characters(codec="ascii", exclude_categories=["Cc"]), max_size=5),
    lambda inner: st.lists(inner, max_size=3),
    max_leaves=20,
)


@given(trees)
def test_the_depth_of_lists_is_counted(tree):
    def levels(node) -> int:
        return 1 + max(map(levels, node), default=0) if isinstance(node, list) else 0

    def text(node) -> str:
        if isinstance(node, list):
            return f"[{', '.join(map(text, node))}]"
        escaped = str(node).replace("\\", "\\\\").replace('"', '\\"')
        return f'"{escaped}"' if isinstance(node, str) else str(node)

    assert depth(f"a = {text(tree)}\n") == max(1, levels(tree))
    assert parse_toml(f"a = {text(tree)}\n", "a", "b") == {"a": tree}
