"""Key files: who can read them, what is refused, and that a clock set back is noticed."""

from __future__ import annotations

import hashlib
import stat
from pathlib import Path

import pytest

from trimtab.host.base.errors import UsageError
from trimtab.host.link.keys import CLOCK_BACK_S, new_key, read_key, use_key

NOW = 38_000_000_000_000
SECOND = 100_000


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "lab.key"
    new_key(path)
    return path


def test_new_key_is_random_and_readable_by_its_owner_only(file: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.key"
    new_key(other)
    assert read_key(file).key != read_key(other).key
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert sorted(path.name for path in tmp_path.iterdir()) == ["lab.key", "other.key"]


def test_key_is_the_hash_of_the_files_text_as_ground_stations_derive_it(file: Path) -> None:
    text = file.read_text().strip()
    assert len(text) == 64
    assert read_key(file).key.secret == hashlib.sha256(text.encode()).digest()


def test_new_key_overwrites_only_with_force(file: Path, tmp_path: Path) -> None:
    before = read_key(file).key
    with pytest.raises(UsageError, match="--force"):
        new_key(file)
    assert read_key(file).key == before
    new_key(file, force=True)
    assert read_key(file).key != before
    assert stat.S_IMODE(file.stat().st_mode) == 0o600
    assert [path.name for path in tmp_path.iterdir()] == ["lab.key"]


@pytest.mark.parametrize("mode", [0o640, 0o604, 0o660])
def test_key_that_others_can_read_is_refused_with_the_remedy(file: Path, mode: int) -> None:
    file.chmod(mode)
    with pytest.raises(UsageError, match=f"chmod 600 {file}"):
        read_key(file)


@pytest.mark.parametrize("content", [b"", b"0" * 63, b"0" * 66 + b"\n", b"secret\xff", b"G" * 64])
def test_key_of_another_form_is_refused_without_repeating_it(file: Path, content: bytes) -> None:
    file.write_bytes(content)
    with pytest.raises(UsageError, match="64 hexadecimal digits") as caught:
        read_key(file)
    assert "secret" not in str(caught.value)
    assert caught.value.exit_code == 2


def test_missing_key_file_is_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        read_key(tmp_path / "none.key")


def test_clock_set_back_since_the_last_use_is_refused(file: Path) -> None:
    use_key(file, NOW)
    use_key(file, NOW - CLOCK_BACK_S * SECOND)
    use_key(file, NOW + 5)
    with pytest.raises(UsageError, match=r"clock is 3600 s behind .*lab.key.used"):
        use_key(file, NOW + 5 - 3600 * SECOND)
    use_key(file, NOW + 6)


def test_damaged_record_of_the_last_use_is_refused(file: Path) -> None:
    file.with_name("lab.key.used").write_text("yesterday")
    with pytest.raises(UsageError, match="remove this file"):
        use_key(file, NOW)


def test_new_key_with_force_forgets_the_use_of_the_former_one(file: Path) -> None:
    use_key(file, NOW)
    new_key(file, force=True)
    use_key(file, NOW - 3600 * SECOND)
