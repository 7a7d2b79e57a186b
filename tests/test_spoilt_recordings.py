"""Real recordings spoiled as real ones are: the error at most doubles, and nothing new moves."""

from collections.abc import Generator, Iterable
from dataclasses import dataclass, fields, replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ovmot.datasets.registry import open_sequence
from ovmot.datasets.sequence import RecordedSequence
from ovmot.geometry.arrays import Image
from ovmot.run import RunOptions, run_sequence
from ovmot.run_evaluation import evaluate
from ovmot.settings import Settings
from ovmot.sim.faults import FaultySequence, InjectedFault, Span, with_faults
from ovmot.types import Event, StereoFrame

pytestmark = [pytest.mark.slow, pytest.mark.xdist_group("euroc")]
QUARTER, LONG_S = (0.4, 0.65), 1.5
ATE = "ate_se3_m"


def error_of(sequence: RecordedSequence, data: Path, out: Path, threads: int = 2) -> float:
    """Error of the ego motion, metres, SE(3)-aligned; each frame after the start has a pose."""
    summary = run_sequence(sequence, Settings(), RunOptions(out, threads=threads))
    missing = summary.counts["frames_before_start"] + summary.counts["frames_written"]
    assert missing == summary.counts["frames_read"]
    ate = evaluate(out, data).scalars()[ATE]
    assert ate is not None
    return ate


def confirmed(out: Path) -> int:
    """Confirmed boxes in all frames."""
    return (out / "tracks.csv").read_text().count(",confirmed,")


@pytest.fixture(scope="module")
def euroc(data_root: Path) -> Path:
    return data_root / "euroc_mh01"


def part(sequence: RecordedSequence, begin: float, end: float) -> Span:
    """From one share of the recording to another."""
    first, last = int(sequence.frame_ns[0]), int(sequence.frame_ns[-1])
    return Span(first + round(begin * (last - first)), first + round(end * (last - first)))


@pytest.mark.parametrize(
    ("name", "count"), [("right_gone", "right_missing"), ("left_gone", "left_missing")]
)
def test_one_camera_goes_on_without_the_other(
    name: str, count: str, euroc: Path, euroc_error_m: float, tmp_path: Path
) -> None:
    """A quarter of the recording; before, those frames had no pose, and the error was tenfold."""
    whole = open_sequence(euroc)
    spoilt = with_faults(whole, InjectedFault(name, part(whole, *QUARTER)))
    assert error_of(spoilt, euroc, tmp_path / "run") < 2.0 * euroc_error_m
    assert confirmed(tmp_path / "run") == 0


@pytest.mark.parametrize("name", ["frozen_images", "black_images"])
def test_pictures_that_lie_do_little_harm(
    name: str, euroc: Path, euroc_error_m: float, tmp_path: Path
) -> None:
    """For 1.5 s; the IMU carries the pose."""
    whole = open_sequence(euroc)
    begin = part(whole, 0.5, 1.0).begin_ns
    span = Span(begin, begin + round(1e9 * LONG_S))
    spoilt = with_faults(whole, InjectedFault(name, span))
    assert error_of(spoilt, euroc, tmp_path / "run") < 3.0 * euroc_error_m
    assert confirmed(tmp_path / "run") == 0


@dataclass(frozen=True, slots=True, kw_only=True)
class WithBonnet(FaultySequence):
    """A textured bonnet 1.5 m ahead, at the bottom of both pictures."""

    def events(self, first: int = 0, last: int | None = None) -> Generator[Event, None, None]:
        masks = bonnet(self)
        for event in self.inner.events(first, last):
            yield painted(event, masks)


def bonnet(sequence: RecordedSequence) -> tuple[tuple[Image, Image], tuple[Image, Image]]:
    """Mask and texture of each camera."""
    rig = sequence.rig
    height, width = rig.cam0.height, rig.cam0.width
    shift = round(rig.cam0.fx * rig.baseline / 1.5)
    noise = np.random.default_rng(0).uniform(0.0, 255.0, (height, width + 2 * shift))
    smooth = cv2.GaussianBlur(noise.astype(np.float32), (0, 0), 2.0)
    grey = np.clip((smooth - smooth.mean()) / smooth.std() * 40.0 + 110.0, 0, 255).astype(np.uint8)
    mask = np.zeros((height, width + 2 * shift), dtype=np.uint8)
    centre = (shift + width // 2, round(1.05 * height))
    axes = (round(0.42 * width), round(0.28 * height))
    cv2.ellipse(mask, centre, axes, 0, 0, 360, 255, cv2.FILLED)
    left, right = slice(shift, shift + width), slice(2 * shift, 2 * shift + width)
    return (mask[:, left], grey[:, left]), (mask[:, right], grey[:, right])


def painted(event: Event, masks: Iterable[tuple[Image, Image]]) -> Event:
    if not isinstance(event, StereoFrame):
        return event
    left, right = (
        np.where(mask > 0, grey, image)
        for image, (mask, grey) in zip(event.pair, masks, strict=True)
    )
    return replace(event, left=left, right=right)


def test_the_rigs_own_bonnet_is_no_object(data_root: Path, tmp_path: Path) -> None:
    """On a street with traffic: no more boxes than without it, and a mask of it is written."""
    data = data_root / "street_traffic"
    whole = open_sequence(data)
    same = {each.name: getattr(whole, each.name) for each in fields(RecordedSequence)}
    spoilt = WithBonnet(**same, inner=whole, faults=())
    plain, with_it = tmp_path / "plain", tmp_path / "bonnet"
    for sequence, out in ((whole, plain), (spoilt, with_it)):
        run_sequence(sequence, Settings(), RunOptions(out, threads=2))
    before, after = (evaluate(out, data).scalars()["false_boxes"] for out in (plain, with_it))
    assert before is not None and after is not None and after <= before + 2
    mask = cv2.imread(str(with_it / "ego_mask_cam0.png"), cv2.IMREAD_GRAYSCALE)
    assert mask is not None
    (painted_mask, _), _ = bonnet(whole)
    assert (painted_mask[mask > 0] > 0).mean() > 0.7
    assert not (plain / "ego_mask_cam0.png").exists()
