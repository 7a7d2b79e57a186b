"""Pairs by stamps: exact, near, in any order, and what is left over."""

from ovmot.ros.pairing import StereoPairing

MS = 1_000_000


def test_exact_and_near_stamps_make_pairs_whatever_comes_first() -> None:
    pairing = StereoPairing(5 * MS)
    assert pairing.add("left", 100 * MS, "l0") is None
    pair = pairing.add("right", 103 * MS, "r0")
    assert pair is not None
    assert (pair.timestamp_ns, pair.left, pair.right) == (100 * MS, "l0", "r0")
    assert pairing.add("right", 200 * MS, "r1") is None
    pair = pairing.add("left", 200 * MS, "l1")
    assert pair is not None
    assert (pair.timestamp_ns, pair.left, pair.right) == (200 * MS, "l1", "r1")
    assert pairing.unpaired == 0


def test_too_far_apart_is_no_pair_and_says_how_far() -> None:
    pairing = StereoPairing(5 * MS)
    pairing.add("left", 100 * MS, "l0")
    assert pairing.add("right", 106 * MS, "r0") is None
    assert pairing.nearest_ns == 6 * MS


def test_a_missing_image_costs_its_partner_only() -> None:
    pairing = StereoPairing(5 * MS)
    pairing.add("left", 100 * MS, "lonely")
    pairing.add("left", 200 * MS, "l1")
    pair = pairing.add("right", 200 * MS, "r1")
    assert pair is not None and pair.left == "l1"
    assert pairing.unpaired == 1
    assert pairing.add("right", 100 * MS, "too late") is None


def test_one_camera_alone_does_not_fill_memory() -> None:
    pairing = StereoPairing(5 * MS)
    for i in range(100):
        pairing.add("left", i * 100 * MS, i)
    assert pairing.unpaired == 90
    pair = pairing.add("right", 99 * 100 * MS, "r")
    assert pair is not None and pair.left == 99
