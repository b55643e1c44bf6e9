"""A file is there whole or not at all."""

import pytest

from hident.errors import StoreError
from hident.new_files import replacing


def test_a_file_takes_its_place_when_it_is_whole(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("old")
    with replacing(path) as new:
        assert new.suffix == ".csv"
        new.write_text("new")
        assert path.read_text() == "old"
    assert path.read_text() == "new"
    assert list(tmp_path.iterdir()) == [path]


def test_what_was_begun_leaves_nothing(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("old")
    with pytest.raises(ZeroDivisionError), replacing(path) as new:
        new.write_text("half")
        raise ZeroDivisionError
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_cannot_be_written_is_said(tmp_path):
    (tmp_path / "folder").mkdir()
    for path, reason in (
        (tmp_path / "no" / "a", "no such file or directory"),
        (tmp_path / "folder", "is a directory"),
    ):
        with pytest.raises(StoreError) as caught, replacing(path) as new:
            new.write_text("x")
        assert str(caught.value) == f"{path} cannot be written: {reason}"
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]
