"""The long run with faults, here for 40 s of data: it comes to its end and reports."""

import pytest

import soak
from soak import Soak, features_soak, report, up_and_down


@pytest.mark.slow
def test_features_with_two_faults(capsys: pytest.CaptureFixture[str]) -> None:
    found = features_soak(0.75, seed=0)
    assert sum(found.faults.values()) == 2
    assert not found.not_well
    assert found.n_frames > 250
    assert found.asymmetric == 0
    assert found.least_eigenvalue > soak._LEAST_EIGENVALUE
    report("features", 0.75, found)
    assert "not well 3 s after it" in capsys.readouterr().out


def test_what_is_not_as_it_should_be_is_no_success(capsys: pytest.CaptureFixture[str]) -> None:
    def outcome(memory: list[float], asymmetric: int = 0) -> bool:
        found = Soak(memory=memory, asymmetric=asymmetric, least_eigenvalue=-1e-12)
        return report("none", 1.0, found)

    assert outcome([5.0, 1.0, 1.0, 1.04])
    assert not outcome([5.0, 1.0, 1.0, 1.06])
    assert not outcome([1.0], asymmetric=1)
    capsys.readouterr()


def test_the_street_is_driven_up_and_down() -> None:
    simulation = up_and_down(1.5, 0)
    start_ns = int(simulation.camera_ns[0])
    there = simulation.path.pose(start_ns)
    back = simulation.path.pose(start_ns + 40_000_000_000)
    assert abs(there - back).max() < 1e-3
    speed = abs(simulation.path.velocity(simulation.camera_ns[:600])).max()
    assert 2.0 < speed < 20.0
