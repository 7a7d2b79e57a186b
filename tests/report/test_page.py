"""The page as a file: nothing of the data becomes markup, and nothing is fetched."""

import json
import re
from pathlib import Path

import pytest
from run_folders import write_run

from ovmot.cameras.rig import StereoRig
from ovmot.errors import InputError, OvmotError
from ovmot.report.page import embedded
from ovmot.report.remedies import remedy_of, remedy_of_ending
from ovmot.report.report import write_report

EVIL = "</script><script>alert(1)</script><img src=http://example.com/x onerror=alert(2)>"


def data_of(page: str) -> object:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert found is not None
    loaded: object = json.loads(found[1])
    return loaded


def test_what_comes_from_files_is_data_alone(tmp_path: Path, painted_rig: StereoRig) -> None:
    folder = write_run(tmp_path / "<b>&run", painted_rig, 5, warning=EVIL)
    page = write_report([folder]).read_text(encoding="utf-8")
    assert page.count("<script") == 2
    assert "alert(1)" in page  # in the data
    assert EVIL not in page
    assert "<b>" not in page
    data = data_of(page)
    assert isinstance(data, dict)
    assert data["runs"][0]["warnings"][0]["message"] == EVIL
    assert data["runs"][0]["name"] == "<b>&run"


def test_the_policy_allows_nothing_but_the_page_itself(
    tmp_path: Path, painted_rig: StereoRig
) -> None:
    page = write_report([write_run(tmp_path / "run", painted_rig, 5)]).read_text(encoding="utf-8")
    found = re.search(r'Content-Security-Policy" content="([^"]*)"', page)
    assert found is not None
    assert "default-src 'none'" in found[1]
    assert "unsafe" not in found[1]
    assert not re.findall(r'(?:src|href)="(?!data:|#)[^"]*"', page)


@pytest.mark.parametrize("text", ["</script>", "<!--", "&lt;", "é\u2028\ud800"])
def test_embedded_text_comes_back(text: str) -> None:
    inside = embedded({"text": text})
    assert "<" not in inside
    assert inside.isascii()
    assert json.loads(inside) == {"text": text}


def test_where_the_page_is_written(
    tmp_path: Path, painted_rig: StereoRig, monkeypatch: pytest.MonkeyPatch
) -> None:
    a, b = (write_run(tmp_path / name, painted_rig, 5) for name in "ab")
    assert write_report([a]) == a / "report.html"
    assert write_report([a], tmp_path / "other.html") == tmp_path / "other.html"
    monkeypatch.chdir(tmp_path)
    assert write_report([a, b]).resolve() == tmp_path / "report.html"
    with pytest.raises(OvmotError, match=r"missing/page\.html: cannot be written"):
        write_report([a], tmp_path / "missing" / "page.html")


def test_what_is_no_run_is_a_clear_error(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is not a run"):
        write_report([tmp_path])
    with pytest.raises(InputError, match="needs a run"):
        write_report([])


@pytest.mark.parametrize(
    "warning",
    [
        "stereo matches refused by the extrinsics, of 100: try 'ovmot doctor'",
        "frames whose pose rests on the IMU alone (`health` in state.csv)",
        "new starts because the motion was lost: the position may jump there",
        "left pictures that were flat: the other camera went on alone",
        "IMU samples at the end of the sensor's range: left out",
    ],
)
def test_each_warning_of_a_run_has_its_own_remedy(warning: str) -> None:
    assert remedy_of(warning) != remedy_of("something nobody has heard of")


def test_an_ending_that_is_none_says_what_it_means() -> None:
    assert remedy_of_ending("finished") == ""
    for ended in ("running", "interrupted", "failed: disk full"):
        assert "whole" in remedy_of_ending(ended)
