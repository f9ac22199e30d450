# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The demo: a recorded drive through the live localizer, next to what it would be without.

Plays bags/round into live ROS topics at up to twenty times real time, as fast as the localizer
keeps up, records its odom, and compares: wheels alone, the plain EKF and the FNN-EKF
(`adaptation: joint`, the default), all started with wheel noise five times too small and
measurement noise five times too large (variances wrong by 25), and the EKF that knows the true
noise.

The results go into demo/ once all of them are there; until then it keeps the last ones.
"""

import argparse
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from child_processes import end
from command_line import exit_code

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.messages import ODOMETRY_TYPE
from fnn_ekf_ros.ros.record import Recorder
from fnn_ekf_ros.stopping import exit_by_signal

ROOT = Path(__file__).resolve().parents[1]
"""Folder of the clone."""
BAG, PARAMETERS, OUT = Path("bags/round"), Path("bags/round.yaml"), Path("demo")
"""The recorded drive, the parameters of its robot, and the folder for results, in the clone."""
PICTURE, NUMBERS = "tracks.png", "errors.json"
"""Names of the result files."""
RATE = 20
"""Largest rate at which the bag is played [times real time]."""
PATIENCE_S, STOPPING_S = 60.0, 10.0
"""Longest waits: for a node to do something, and for a process to end before it is killed [s]."""
WHEELS = ["encoder_source:=joint_states"]
"""Parameter for wheels with the robot's stamps: the result does not depend on when they arrive."""
WRONG = ["process_noise_std:=[0.01, 0.0105]", "measurement_noise_std:=[0.5, 0.5, 0.67]"]
"""Parameters of a wrong start: Q five times too small, R five times too large (std)."""
PLAIN = ["adaptation:=none"]
"""Parameter of the plain EKF."""
PLAYED = ["joint_states", "compass", "lrf_pose"]
"""Topics of the bag that are played."""
LIVE = "FNN-EKF, live"
"""Name of the live run in the table."""
RUNS = {
    "dead reckoning": "wheels_only",
    "EKF": "ekf",
    LIVE: "live",
    "FNN-EKF, replay": "fnn_ekf",
    "EKF, true noise": "ekf_true_noise",
}
"""Folder of each row of the table."""


def command(name: str, *arguments: object) -> list[str]:
    """Return the command line of one of the package's executables."""
    return [sys.executable, "-m", "fnn_ekf_ros", name, *map(str, arguments)]


def assigned(assignments: Sequence[str]) -> list[str]:
    """Return assignments as arguments."""
    return [word for text in assignments for word in ("-p", text)]


REPLAYS = {
    "wheels_only": ["--dead-reckoning", *assigned([*WHEELS, *WRONG, *PLAIN])],
    "ekf": assigned([*WHEELS, *WRONG, *PLAIN]),
    "fnn_ekf": assigned([*WHEELS, *WRONG]),
    "ekf_true_noise": assigned([*WHEELS, *PLAIN]),
}
"""Arguments of each replay."""


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Let signals that end the demo take effect at the end of a block."""
    came: list[int] = []
    before = {
        number: signal.signal(number, lambda number, _: came.append(number))
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    }
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for number in came:
            signal.raise_signal(number)


@contextmanager
def running(arguments: list[str], **options: Any) -> Iterator[subprocess.Popen[str]]:
    """Run a process for the length of a block.

    It has a process group of its own: Ctrl-C is the demo's, which then ends the process.
    """
    with ExitStack() as stack:
        with signals_deferred():
            process = subprocess.Popen(arguments, process_group=0, text=True, **options)
            stack.callback(end, process, signal.SIGTERM, STOPPING_S)
        yield process


def live(out: Path) -> None:
    """Record what the live localizer makes of the played bag.

    Raises:
        FnnEkfError: the localizer or play failed.
    """
    assignments = assigned([*WHEELS, *WRONG, "use_sim_time:=true"])
    ros = [
        "--ros-args", "--params-file", PARAMETERS, *assignments, "--log-level", "localizer:=error",
    ]  # fmt: skip
    with Recorder(out, {"/odom": ODOMETRY_TYPE}) as recorder, running(command("localizer", *ros)):
        deadline = time.monotonic() + PATIENCE_S
        while not recorder.connected():
            recorder.spin_once(0.05)
            if time.monotonic() > deadline:
                raise FnnEkfError("the localizer did not come up")
        play = command(
            "play", BAG, "--rate", RATE, "--clock", "--keep-pace-with", "odom",
            "--patience", PATIENCE_S, "--topics", *PLAYED,
            "--wait-for-subscribers", PATIENCE_S, "--delay", 1,
        )  # fmt: skip
        with running(play) as player:
            while player.poll() is None:
                recorder.spin_once(0.05)
                show(f"  {recorder.counts['/odom']} odom")
        if player.returncode:
            raise FnnEkfError("play failed")
        quiet = time.monotonic() + 1.0
        while time.monotonic() < quiet:
            before = recorder.counts["/odom"]
            recorder.spin_once(0.05)
            if recorder.counts["/odom"] > before:
                quiet = time.monotonic() + 1.0
    show("")
    print(f"  {recorder.counts['/odom']} odom")


def replay(out: Path) -> None:
    """Run the localizer over the bag in each of the ways to compare with.

    Raises:
        FnnEkfError: a replay failed.
    """
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with ExitStack() as stack:
        started = [
            stack.enter_context(
                running(
                    command("replay", BAG, out / name, "--params", PARAMETERS, *arguments), **pipes
                )
            )
            for name, arguments in REPLAYS.items()
        ]
        for process in started:
            said, trouble = process.communicate()
            if process.returncode:
                raise FnnEkfError(trouble.strip())
            done, *_ = said.splitlines()  # what follows is the health of runs that are wrong
            print(f"  {done.replace(str(out), str(OUT))}")


def evaluate(out: Path) -> None:
    """Print the table; write the numbers and the picture.

    Raises:
        FnnEkfError: evaluate failed.
    """
    arguments = command(
        "evaluate", *(out / name for name in RUNS.values()), "--truth-bag", BAG,
        "--labels", *RUNS, "--json", out / NUMBERS, "--plot", out / PICTURE,
        "--highlight", LIVE, "--draw", "dead reckoning", "EKF", LIVE,
    )  # fmt: skip
    with running(arguments) as process:
        process.wait()
    if process.returncode:
        raise FnnEkfError("evaluate failed")


def show(text: str) -> None:
    """Show progress; on a terminal it replaces what was shown before."""
    if sys.stdout.isatty():
        print(f"\r{text}", end="", flush=True)


@contextmanager
def replaced(out: Path) -> Iterator[Path]:
    """Give a new folder to a block, which replaces the old one if the block succeeds.

    Raises:
        FnnEkfError: what is there is no folder.
        OSError: the folder cannot be made or replaced.
    """
    if os.path.lexists(out) and (out.is_symlink() or not out.is_dir()):
        raise FnnEkfError(f"'{out}' is no folder: remove it first")
    with TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as work:
        new, old = Path(work) / out.name, Path(work) / "old"
        new.mkdir()
        yield new
        try:
            if out.exists():
                out.rename(old)
            new.rename(out)
        finally:
            if old.exists() and not out.exists():
                old.rename(out)


def run() -> None:
    """Run the demo.

    Raises:
        FnnEkfError: a part of it failed.
        OSError: a folder or a file cannot be written.
    """
    with replaced(OUT) as out:
        print(f"Playing {BAG} into the live localizer, up to {RATE} times real time:")
        live(out / "live")
        print("Replaying it offline for comparison:")
        replay(out)
        print(
            "\nErrors against the ground truth. All but the last run start with wheel noise five "
            "times too small\nand measurement noise five times too large:\n"
        )
        evaluate(out)
    print(f"\nPicture: {OUT / PICTURE}, numbers: {OUT / NUMBERS}")


def main(argv: Sequence[str] | None = None) -> int:
    """Run the demo; return the exit code."""
    argparse.ArgumentParser(description=__doc__).parse_args(argv)
    exit_by_signal()
    sys.stdout.reconfigure(line_buffering=True)  # in order with what the commands print
    os.chdir(ROOT)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 90))  # two demos do not meet
    return exit_code("demo", run, f"{OUT}/ stays as it was")


if __name__ == "__main__":
    sys.exit(main())
