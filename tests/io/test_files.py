"""Files that are whole or not there, and secret keys in files."""

import stat

import pytest

from ptnsbc_core.errors import PtnsbcError
from ptnsbc_io.files import OutputFileError, read_key, replacing

KEY = bytes(range(32))


def test_key_files(tmp_path):
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o600)
    assert read_key(path) == KEY
    path.write_bytes(KEY)
    assert read_key(path) == KEY
    for wrong in (b"short", b"", bytes(32), b"0" * 64):
        path.write_bytes(wrong)
        with pytest.raises(PtnsbcError, match="expected 32"):
            read_key(path)
    path.chmod(0o600 | stat.S_IRGRP)
    with pytest.raises(PtnsbcError, match="chmod 600"):
        read_key(path)
    with pytest.raises(PtnsbcError, match="readable key file"):
        read_key(tmp_path / "nothing")


@pytest.mark.parametrize("error", [OSError(28, "No space left"), KeyboardInterrupt(), ValueError()])
def test_what_is_half_written_leaves_nothing_behind(tmp_path, error):
    path = tmp_path / "made" / "file"
    expected = OutputFileError if isinstance(error, OSError) else type(error)
    with pytest.raises(expected), replacing(path, folder=True) as part:
        part.write_text("half")
        raise error
    assert not list(path.parent.iterdir())
    with replacing(path) as part:
        part.write_text("whole")
    assert [(one.name, one.read_text()) for one in path.parent.iterdir()] == [("file", "whole")]
