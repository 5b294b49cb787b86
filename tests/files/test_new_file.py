"""New files: a free name, and no file replaced."""

import pytest

from skyherd.errors import OutputError
from skyherd.files.new_file import write_new_file


def test_new_file_never_replaces_another(tmp_path):
    (tmp_path / "a.toml").write_text("precious")
    paths = [write_new_file(tmp_path, "a", ".toml", text) for text in "xy"]
    assert [path.name for path in paths] == ["a-2.toml", "a-3.toml"]
    assert [path.read_text() for path in paths] == ["x", "y"]
    assert (tmp_path / "a.toml").read_text() == "precious"


def test_new_file_in_missing_folder_is_one_error(tmp_path):
    with pytest.raises(OutputError, match="cannot be written"):
        write_new_file(tmp_path / "none", "a", ".toml", "x")
