"""The demo: a recorded drive through the live localizer, next to what it would be without.

Plays bags/round into live ROS topics at ten times real time, runs the localizer on them, records
its odom, and compares: wheels alone, the plain EKF and the FNN-EKF (`adaptation: joint`, the
default), all started with wheel noise five times too small and measurement noise five times too
large (variances wrong by 25), and the EKF that was told the true noise.
"""

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from fnn_ekf_ros.messages import ODOMETRY_TYPE
from fnn_ekf_ros.ros.record import Recorder

ROOT = Path(__file__).resolve().parents[1]
BAG, PARAMETERS = ROOT / "bags" / "round", ROOT / "bags" / "round.yaml"
OUT = ROOT / "demo"
RATE = 10
PATIENCE_S = 60.0
WRONG = ["process_noise_std:=[0.01, 0.0105]", "measurement_noise_std:=[0.5, 0.5, 0.67]"]
PLAIN = ["adaptation:=none"]
PLAYED = ["left_ticks", "right_ticks", "compass", "lrf_pose"]


def command(name: str, *arguments: object) -> list[str]:
    """Return the command line of one of the package's executables."""
    return [sys.executable, "-m", "fnn_ekf_ros", name, *map(str, arguments)]


def assigned(assignments: Sequence[str]) -> list[str]:
    """Return assignments as arguments."""
    return [word for text in assignments for word in ("-p", text)]


@contextmanager
def running(arguments: list[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process for the length of a block, ended by SIGINT."""
    process = subprocess.Popen(arguments)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        process.wait(timeout=PATIENCE_S)


def live(out: Path) -> None:
    """Record what the live localizer makes of the played bag."""
    ros = ["--ros-args", "--params-file", PARAMETERS, *assigned([*WRONG, "use_sim_time:=true"])]
    with Recorder(out, {"/odom": ODOMETRY_TYPE}) as recorder, running(command("localizer", *ros)):
        deadline = time.monotonic() + PATIENCE_S
        while not recorder.connected():
            recorder.spin_once(0.05)
            if time.monotonic() > deadline:
                sys.exit("demo: the localizer did not come up")
        play = command(
            "play", BAG, "--rate", RATE, "--clock", "--topics", *PLAYED,
            "--wait-for-subscribers", PATIENCE_S, "--delay", 1,
        )  # fmt: skip
        with running(play) as player:
            while player.poll() is None:
                recorder.spin_once(0.05)
                show(f"  live: {recorder.counts['/odom']} odom")
        if player.returncode:
            sys.exit("demo: play failed")
        quiet = time.monotonic() + 1.0
        while time.monotonic() < quiet:
            recorder.spin_once(0.05)
    show("\n")


def show(text: str) -> None:
    """Show progress; on a terminal it replaces what was shown before."""
    if sys.stdout.isatty():
        print(f"\r{text}", end="", flush=True)


def main() -> None:
    """Run the demo."""
    sys.stdout.reconfigure(line_buffering=True)  # in order with what the commands print
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 90))  # two demos do not meet
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir()
    print(f"Playing {BAG.name} into the live localizer, {RATE} times real time:", flush=True)
    live(OUT / "live")
    print("Replaying it offline for comparison:", flush=True)
    for name, options in (
        ("wheels_only", ["--dead-reckoning", *assigned([*WRONG, *PLAIN])]),
        ("ekf", assigned([*WRONG, *PLAIN])),
        ("fnn_ekf", assigned(WRONG)),
        ("ekf_true_noise", assigned(PLAIN)),
    ):
        subprocess.run(
            command("replay", BAG, OUT / name, "--params", PARAMETERS, *options), check=True
        )
    bags = [OUT / name for name in ("wheels_only", "ekf", "live", "fnn_ekf", "ekf_true_noise")]
    labels = ["dead reckoning", "EKF", "FNN-EKF, live", "FNN-EKF, replay", "EKF, true noise"]
    picture = OUT / "tracks.png"
    print(
        "\nStarted with wheel noise five times too small and measurement noise five times too "
        "large\n(but for the last line):\n"
    )
    subprocess.run(
        command(
            "evaluate", *bags, "--truth-bag", BAG, "--labels", *labels,
            "--json", OUT / "errors.json", "--plot", picture,
        ),
        check=True,
    )  # fmt: skip
    errors = json.loads((OUT / "errors.json").read_text(encoding="utf-8"))
    live_run, replayed = errors["FNN-EKF, live"], errors["FNN-EKF, replay"]
    if live_run["rmse_position"] > 1.05 * replayed["rmse_position"]:
        print(
            "\nThe live run is worse than the replay: this machine was busy, and ticks that carry "
            "no stamp\nare as late as they are received (joint_states are stamped, and are not)."
        )
    print(f"\nPicture: {picture.relative_to(ROOT)}, numbers: demo/errors.json")


if __name__ == "__main__":
    main()
