"""The demo: a recorded drive through the live localizer, next to what it would be without.

Plays bags/round into live ROS topics at up to twenty times real time, as fast as the localizer
keeps up, records its odom, and compares: wheels alone, the plain EKF and the FNN-EKF
(`adaptation: joint`, the default), all started with wheel noise five times too small and
measurement noise five times too large (variances wrong by 25), and the EKF that was told the true
noise.
"""

import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

from fnn_ekf_ros.messages import ODOMETRY_TYPE
from fnn_ekf_ros.ros.record import Recorder

ROOT = Path(__file__).resolve().parents[1]
BAG, PARAMETERS, OUT = Path("bags/round"), Path("bags/round.yaml"), Path("demo")
RATE = 20
PATIENCE_S = 60.0
WHEELS = ["encoder_source:=joint_states"]
"""They carry the robot's stamps, so the result does not depend on when they arrive."""
WRONG = ["process_noise_std:=[0.01, 0.0105]", "measurement_noise_std:=[0.5, 0.5, 0.67]"]
PLAIN = ["adaptation:=none"]
PLAYED = ["joint_states", "compass", "lrf_pose"]
LIVE = "FNN-EKF, live"
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
    assignments = assigned([*WHEELS, *WRONG, "use_sim_time:=true"])
    ros = [
        "--ros-args", "--params-file", PARAMETERS, *assignments, "--log-level", "localizer:=error",
    ]  # fmt: skip
    with Recorder(out, {"/odom": ODOMETRY_TYPE}) as recorder, running(command("localizer", *ros)):
        deadline = time.monotonic() + PATIENCE_S
        while not recorder.connected():
            recorder.spin_once(0.05)
            if time.monotonic() > deadline:
                sys.exit("demo: the localizer did not come up")
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
            sys.exit("demo: play failed")
        quiet = time.monotonic() + 1.0
        while time.monotonic() < quiet:
            before = recorder.counts["/odom"]
            recorder.spin_once(0.05)
            if recorder.counts["/odom"] > before:
                quiet = time.monotonic() + 1.0
    show("")
    print(f"  {recorder.counts['/odom']} odom")


def replay(name: str) -> str:
    """Run the localizer's pipeline over the bag; return what the command says."""
    arguments = command("replay", BAG, OUT / name, "--params", PARAMETERS, *REPLAYS[name])
    done = subprocess.run(arguments, check=False, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"demo: {done.stderr}")
    return done.stdout.strip()


def show(text: str) -> None:
    """Show progress; on a terminal it replaces what was shown before."""
    if sys.stdout.isatty():
        print(f"\r{text}", end="", flush=True)


def main() -> None:
    """Run the demo."""
    sys.stdout.reconfigure(line_buffering=True)  # in order with what the commands print
    os.chdir(ROOT)
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    os.environ.setdefault("ROS_DOMAIN_ID", str(1 + os.getpid() % 90))  # two demos do not meet
    shutil.rmtree(OUT, ignore_errors=True)
    OUT.mkdir()
    print(f"Playing {BAG} into the live localizer, up to {RATE} times real time:", flush=True)
    live(OUT / "live")
    print("Replaying it offline for comparison:", flush=True)
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for said in pool.map(replay, REPLAYS):
            print(f"  {said}")
    print(
        "\nErrors against the ground truth. All but the last run start with wheel noise five times "
        "too small\nand measurement noise five times too large:\n"
    )
    picture, numbers = OUT / "tracks.png", OUT / "errors.json"
    done = subprocess.run(
        command(
            "evaluate", *(OUT / name for name in RUNS.values()), "--truth-bag", BAG,
            "--labels", *RUNS, "--json", numbers, "--plot", picture,
            "--highlight", LIVE, "--draw", "dead reckoning", "EKF", LIVE,
        ),
        check=False,
    )  # fmt: skip
    if done.returncode:
        sys.exit("demo: evaluate failed")
    print(f"\nPicture: {picture}, numbers: {numbers}")


if __name__ == "__main__":
    main()
