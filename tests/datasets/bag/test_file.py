"""Bags as files: truncated ones, and folders without metadata."""

from pathlib import Path

import pytest
from bag_fixtures import (
    frames,
    mono,
    write_bag,
)

from ovmot.datasets.bag.file import bag_at
from ovmot.errors import DatasetError


@pytest.mark.parametrize("name", ["tiny.bag", "tiny.mcap", "tiny"])
def test_a_truncated_bag_is_one_line_with_a_remedy(tmp_path: Path, chain: Path, name: str) -> None:
    path = write_bag(tmp_path / name, {"/left": mono, "/right": mono})
    file = path if path.is_file() else next(path.glob("*.db3"))
    data = file.read_bytes()
    for share in (0.0, 0.2, 0.9, 0.999):
        file.write_bytes(data[: int(share * len(data))])
        with pytest.raises(DatasetError) as found:
            frames(path, chain)
        text = str(found.value)
        assert text.startswith(f"{path}: ") and "copy the bag again" in text
        assert "\n" not in text


def test_a_folder_without_metadata_is_its_only_bag(tmp_path: Path) -> None:
    path = write_bag(tmp_path / "tiny", {"/left": mono, "/right": mono})
    assert bag_at(path) == path
    (path / "metadata.yaml").unlink()
    assert bag_at(path) == path / "tiny.db3"
    assert bag_at(tmp_path) is None
