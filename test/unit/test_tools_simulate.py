"""The command simulate, as from a shell."""

import math
from collections.abc import Callable
from pathlib import Path

import pytest

from fnn_ekf_ros.bag_files import BagReader
from fnn_ekf_ros.parameters.files import read_parameter_file
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.parameters.schema import build

Refuse = Callable[..., str]
Succeed = Callable[..., str]


def contents(folder: Path) -> dict[str, bytes]:
    """Return what a bag's folder holds."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir())}


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_simulate_twice_makes_the_same_bytes(
    tmp_path: Path, succeed: Succeed, storage: str
) -> None:
    made = []
    for folder, seed in (("one", 3), ("two", 3), ("three", 4)):
        (tmp_path / folder).mkdir()
        out = tmp_path / folder / "bag"
        succeed("simulate", out, "--duration", 5, "--storage", storage, "-p", f"seed:={seed}")
        assert sorted(p.name for p in out.parent.iterdir()) == ["bag", "bag.yaml"]
        made.append(contents(out) | {"yaml": out.with_name("bag.yaml").read_bytes()})
    assert made[0] == made[1]
    assert made[0] != made[2]


def test_simulate_writes_what_a_localizer_needs(tmp_path: Path, succeed: Succeed) -> None:
    out = tmp_path / "bag"
    said = succeed(
        "simulate", out, "--duration", 10, "-p", "wheel_radius:=0.1", "-p", "encoder_bits:=16",
        "-p", "path:=sim1", "-p", "compass_std:=0.3",
    )  # fmt: skip
    assert said.count("\n") == 1
    with BagReader(out) as bag:
        assert bag.duration_s == pytest.approx(10.0, abs=0.1)
        assert set(bag.topics) == {
            "/left_ticks", "/right_ticks", "/joint_states", "/compass", "/lrf_pose",
            "/ground_truth",
        }  # fmt: skip
    values = read_parameter_file(tmp_path / "bag.yaml", "localizer")
    parameters = build(LocalizerParameters, values)
    assert (parameters.wheel_radius, parameters.encoder_bits) == (0.1, 16)
    assert parameters.process_noise_std == (0.02, math.radians(1.0))
    assert parameters.measurement_noise_std == (0.1, 0.1, 0.3)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["-p", "sede:=1"], "unknown parameter 'sede': did you mean 'seed'?"),
        (["-p", "seed:=one"], "parameter 'seed' is 'one': expected a whole number"),
        (["-p", "speed:=-1"], "parameter 'speed' is -1: expected a number from "),
        (["-p", "path:=off"], "parameter 'path' is False: expected one of square, "),
        (["-p", "path:=cmd_vel"], "simulate has no cmd_vel"),
        (["-p", "slip_std:=[1]"], "parameter 'slip_std' is [1]: expected a list of 2 numbers"),
        (["-p", "seed"], "-p seed: expected name:=value"),
        (["--duration", "0"], "--duration 0: expected"),
        (["--duration", "nan"], "--duration nan: expected"),
        (["--duration", "1e9"], "--duration 1e+09: expected"),
        (["--params", "missing.yaml"], "parameter file 'missing.yaml': No such file"),
    ],
)
def test_simulate_refuses(tmp_path: Path, refuse: Refuse, words: list[str], expected: str) -> None:
    assert expected in refuse("simulate", tmp_path / "bag", *words)


def test_simulate_overwrites_nothing(tmp_path: Path, refuse: Refuse) -> None:
    (tmp_path / "there").mkdir()
    (tmp_path / "other.yaml").write_text("mine")
    assert "exists already" in refuse("simulate", tmp_path / "there", "--duration", "1")
    assert "exists already" in refuse("simulate", tmp_path / "other", "--duration", "1")
    assert "does not exist" in refuse("simulate", tmp_path / "no" / "bag", "--duration", "1")


def test_simulate_into_the_folder_itself_is_refused(
    tmp_path: Path, refuse: Refuse, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in (".", "/"):
        assert "cannot be the name of a result" in refuse("simulate", name, "--duration", "1")
