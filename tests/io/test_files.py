"""Secret keys in files."""

import stat

import pytest

from ptnsbc_io.files import KeyFileError, read_key

KEY = bytes(range(32))


def test_key_files(tmp_path):
    path = tmp_path / "key"
    path.write_text(KEY.hex() + "\n")
    path.chmod(0o600)
    assert read_key(path) == KEY
    path.write_bytes(KEY)
    assert read_key(path) == KEY
    path.write_text("short")
    with pytest.raises(KeyFileError, match="expected 32"):
        read_key(path)
    path.chmod(0o600 | stat.S_IRGRP)
    with pytest.raises(KeyFileError, match="chmod 600"):
        read_key(path)
    with pytest.raises(KeyFileError, match="readable key file"):
        read_key(tmp_path / "nothing")
