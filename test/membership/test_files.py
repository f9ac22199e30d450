# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Membership files: the packaged ones, and how users' own are refused."""

from importlib import resources
from pathlib import Path

import pytest
from localizers import make_parameters

from fnn_ekf_ros.membership.files import PACKAGED, MembershipError, networks_for, read_membership

PUBLISHED = (resources.files("fnn_ekf_ros.membership") / "published.yaml").read_text("utf-8")


def test_the_packaged_sets_are_the_papers() -> None:
    assert set(PACKAGED) >= {"initial", "published"}
    initial, published = (read_membership(name).sets for name in ("initial", "published"))
    assert (initial.positive_slope, initial.positive_center) == (-0.16, -17.0)
    assert (initial.negative_slope, initial.negative_center) == (0.1, 13.0)
    assert (initial.decrease_slope, initial.decrease_center) == (0.0, -100.0)
    assert (initial.increase_slope, initial.increase_center) == (0.1, 23.0)
    assert (initial.maintain_center, initial.maintain_width) == (0.03, 0.0)
    assert (initial.zero_center, initial.zero_width) == (0.03, 0.03)
    assert (published.positive_slope, published.positive_center) == (-0.1073, -17.0995)
    assert (published.negative_slope, published.negative_center) == (0.1515, 13.8108)
    assert (published.decrease_slope, published.decrease_center) == (-0.06552, -143.0)
    assert (published.increase_slope, published.increase_center) == (0.103, 24.2)
    assert (published.maintain_center, published.maintain_width) == (0.0571, 0.1779)
    assert (published.zero_center, published.zero_width) == (0.0467, 0.062)


def test_the_packaged_sets_count_in_square_millimeters() -> None:
    for name in ("initial", "published"):
        network = read_membership(name)
        assert (network.position_unit, network.yaw_unit) == (1e-6, 1e-6)


def test_a_users_copy_is_the_same(tmp_path: Path) -> None:
    (tmp_path / "own.yaml").write_text(PUBLISHED)
    assert read_membership(str(tmp_path / "own.yaml")) == read_membership("published")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("version: 1", "version: 2", "'version' is 2: expected 1, or a newer"),
        ("version: 1", "", "'version' is missing: expected 1"),
        ("zero_width: 0.0620", "zero_width: 0.0", "'zero_width' is 0.0: expected more"),
        ("zero_width: 0.0620", "zero_width: wide", "'zero_width' is 'wide': expected a number"),
        ("zero_width: 0.0620", "zero_width: .nan", "'zero_width' is nan: expected a number"),
        ("zero_width: 0.0620", "zero_width: true", "'zero_width' is True: expected a number"),
        ("zero_width: 0.0620", "", "'zero_width' is missing"),
        ("zero_width: 0.0620", "zero_wide: 0.0620", "unknown key 'zero_wide'"),
        (
            "yaw_unit: 1.0e-6",
            "yaw_unit: 1.0e-6\nunit: 1",
            "unknown key 'unit': did you mean 'yaw_unit'",
        ),
        ("yaw_unit: 1.0e-6", "yaw_unit: -1.0", "'yaw_unit' is -1.0: expected more than 0"),
        (
            "increase_slope: 0.1030",
            "increase_slope: 0",
            "'increase_slope' is 0: expected another",
        ),
        (
            "maintain_width: 0.1779",
            "maintain_width: -1",
            "'maintain_width' is -1: expected at least 0",
        ),
        ("sets:", "sets: 3\nothers:", "unknown key 'others'"),
        ("version: 1", "version: [1", "is not YAML"),
    ],
)
def test_broken_files_are_refused_in_one_line(
    tmp_path: Path, old: str, new: str, words: str
) -> None:
    assert old in PUBLISHED
    path = tmp_path / "own.yaml"
    path.write_text(PUBLISHED.replace(old, new, 1))
    with pytest.raises(MembershipError) as caught:
        read_membership(str(path))
    assert words in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_files_that_cannot_be_read_are_refused(tmp_path: Path) -> None:
    (tmp_path / "binary").write_bytes(b"\xff\xfe")
    for path, words in (
        (tmp_path / "missing", "does not exist: expected one of initial"),
        (tmp_path, "is no file"),
        (tmp_path / "binary", "text"),
    ):
        with pytest.raises(MembershipError, match=words) as caught:
            read_membership(str(path))
        assert "initial, published" in str(caught.value)
    for content in ("", "- 1", "words"):
        (tmp_path / "odd").write_text(content)
        with pytest.raises(MembershipError, match=r"version|expected membership func"):
            read_membership(str(tmp_path / "odd"))


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"membership_file": "joint"}, "'joint' has units of 1, as sets of mode joint"),
        (
            {"joint_membership_file": "trained"},
            "joint_membership_file 'trained' has units other than 1",
        ),
        ({"joint_membership_file": "nowhere"}, "joint_membership_file 'nowhere' does not exist"),
        ({"membership_file": "nowhere"}, "membership_file 'nowhere' does not exist"),
        (
            {"process_membership_file": "joint"},
            "process_membership_file 'joint' has units of 1",
        ),
        (
            {"process_membership_file": "nowhere"},
            "process_membership_file 'nowhere' does not exist",
        ),
    ],
)
@pytest.mark.parametrize("adaptation", ["joint", "r", "rq", "none"])
def test_a_set_that_is_not_for_its_mode_is_refused_in_every_mode(
    adaptation: str, changes: dict[str, str], said: str
) -> None:
    with pytest.raises(MembershipError, match=said):
        networks_for(make_parameters(adaptation=adaptation, **changes))


def test_each_covariance_gets_its_own_set() -> None:
    published, trained, initial, joint = map(
        read_membership, ("published", "trained", "initial", "joint")
    )
    assert networks_for(make_parameters()) == (published, published, joint)
    of_both = make_parameters(membership_file="trained")
    assert networks_for(of_both) == (trained, trained, joint)
    apart = make_parameters(membership_file="trained", process_membership_file="initial")
    assert networks_for(apart) == (trained, initial, joint)
