"""The fault matrix: every fault through the live localizer, what it said and how far it was off.

Each row is a run of `fake_robot` and `localizer` as processes, on a ROS domain of its own, recorded
from their topics. Writes docs/faults.md and docs/faults.png. Recordings stay in build/faults.
"""

import argparse
import multiprocessing
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import yaml

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.parameters.faults import TOPICS
from fnn_ekf_ros.ros.record import Recorder
from fnn_ekf_ros.text_files import write_text
from fnn_ekf_ros.tools import fault_tables
from fnn_ekf_ros.tools.fault_matrix import Verdict, judge
from fnn_ekf_ros.tools.fault_runs import (
    END_S,
    LASTS_S,
    ONSET_S,
    RECORDED,
    SWITCHED_ON_S,
    TRUTH_INTERVAL_NS,
    Row,
    Run,
    read_run,
)
from fnn_ekf_ros.version import version

ROOT = Path(__file__).resolve().parents[1]
OUT, TABLE, PICTURE = ROOT / "build" / "faults", ROOT / "docs" / "faults.md", "faults.png"
MADE_BY = "made_by"
"""The file beside a recording that says by which version it was made."""
SEED = 1
RATE, TICKS_SHARE = 6.0, 0.5
"""Times real time at first; ticks, which are stamped on arrival, suffer from a hurry: so much of
it."""
PATIENCE_S = 60.0
ATTEMPTS = 4
"""A run whose processes met too late or were too slow is tried again, slower each time."""
BOTH = ("compass", "lrf_pose")
GEOMETRY = ("wheel_radius:=0.025", "wheel_separation:=0.6", "encoder_counts_per_revolution:=500.0")
DISCOVERY = """<?xml version="1.0" encoding="UTF-8"?>
<profiles xmlns="http://www.eprosima.com/XMLSchemas/fastRTPS_Profiles">
  <participant profile_name="soon" is_default_profile="true"><rtps><builtin><discovery_config>
    <initialAnnouncements>
      <count>20</count><period><sec>0</sec><nanosec>50000000</nanosec></period>
    </initialAnnouncements>
    <leaseAnnouncement><sec>0</sec><nanosec>250000000</nanosec></leaseAnnouncement>
  </discovery_config></builtin></rtps></participant>
</profiles>
"""
"""The processes announce themselves often: simulated time does not wait until they have met."""


def once(fault: str, **keys: Any) -> dict[str, Any]:
    """Return a fault that happens at the onset."""
    return {"fault": fault, "start": ONSET_S, **keys}


def lasting(fault: str, **keys: Any) -> dict[str, Any]:
    """Return a fault that lasts from the onset on."""
    return {"fault": fault, "start": ONSET_S, "duration": LASTS_S, **keys}


def shown(topic: str) -> str:
    """Return what a topic's sensor is called."""
    return {"lrf_pose": "fixes"}.get(topic, topic)


def of_both(name: str, meaning: str, fault: str, **keys: Any) -> list[Row]:
    """Return a lasting fault's rows, of the compass and of the fixes; `keys` the same for both."""
    return [
        Row(f"{shown(topic)}: {name}", meaning, (lasting(fault, topic=topic, **keys),))
        for topic in BOTH
    ]


def row(name: str, meaning: str, *timeline: dict[str, Any], **keys: Any) -> Row:
    """Return a row."""
    return Row(name, meaning, timeline, **keys)


LATE = lasting("delay", topic="lrf_pose", size=0.15)
UNDISTURBED = {
    False: row("no fault", "joint_states"),
    True: row("no fault, ticks", "ticks, stamped on arrival", ticks=True),
}
ROWS: tuple[Row, ...] = (
    *UNDISTURBED.values(),
    row("slip", "wet or smooth ground", lasting("slip", factor=5.0)),
    row("unequal wheels", "a flat tyre, a load on one side",
        lasting("unequal_wheels", wheel="left", factor=1.05)),
    row("kidnap, 20 m", "carried away by people", once("kidnap", move=[16.0, 12.0, 1.0])),
    row("stuck wheel", "an encoder's disc is loose", lasting("stuck_wheel", wheel="left")),
    row("stuck wheel, ticks", "the same", lasting("stuck_wheel", wheel="left"), ticks=True),
    row("silent wheel", "a cable is off", lasting("silent_wheel", wheel="left")),
    row("silent wheel, ticks", "the same", lasting("silent_wheel", wheel="left"), ticks=True),
    row("both wheels silent", "the motor controller is off", lasting("silent_wheel", wheel="both")),
    row("tick reset", "the motor controller starts anew", once("tick_reset", wheel="both", count=0),
        ticks=True),
    row("joint_states reset", "the same", once("tick_reset", wheel="both", count=0)),
    row("tick glitch", "a bit flips on the bus",
        once("tick_glitch", wheel="right", size=100_000), ticks=True),
    row("8-bit counters", "they wrap every 0.27 s: nothing is wrong", ticks=True,
        localizer=("encoder_bits:=8",), robot=("encoder_bits:=8",)),
    row("joint_states: dropout", "the same as both wheels silent",
        lasting("dropout", topic="joint_states")),
    row("joint_states: 30 % lost", "a bad radio",
        lasting("dropout", topic="joint_states", rate=0.3)),
    row("joint_states: delay 0.15 s", "a busy computer",
        lasting("delay", topic="joint_states", size=0.15)),
    row("joint_states: NaN", "a driver's division by zero", lasting("nan", topic="joint_states")),
    row("joint_states: reordered", "UDP", lasting("reordered", topic="joint_states")),
    row("joint_states: stamps 5 s ahead", "clocks not synchronised",
        lasting("wrong_stamp", topic="joint_states", size=5.0)),

    *of_both("dropout", "no view of walls, a cable is off", "dropout"),
    *of_both("half of them lost", "a bad radio", "dropout", rate=0.5),
    row("compass: delay 0.15 s", "a slow driver", lasting("delay", topic="compass", size=0.15)),
    row("fixes: delay 0.15 s", "a scan matcher computes", LATE),
    row("fixes: delay 0.15 s, output_delay 0.2", "the same, waited for", LATE,
        localizer=("output_delay:=0.2",)),
    row("fixes: delay 3 s", "longer than history", lasting("delay", topic="lrf_pose", size=3.0)),
    row("fixes: one is lost", "a bad radio", once("dropout", topic="lrf_pose", duration=0.375)),
    row("fixes: a lone 20 m outlier", "a wrong match; moved: against the row above",
        once("outliers", topic="lrf_pose", duration=0.375, size=20.0, rate=1.0),
        without="fixes: one is lost"),
    row("fixes: 10 % at 20 m", "repeated wrong matches",
        lasting("outliers", topic="lrf_pose", size=20.0, rate=0.1)),
    row("compass: a lone outlier of 1.5 rad", "a motor starts", once("outliers", topic="compass",
        duration=0.125, size=1.5, rate=1.0)),
    row("compass: 10 % at 1.5 rad", "a motor starts again and again",
        lasting("outliers", topic="compass", size=1.5, rate=0.1)),
    row("compass: bias 0.3 rad", "iron nearby",
        lasting("bias", topic="compass", size=[0.0, 0.0, 0.3])),
    row("fixes: bias 0.5 m", "furniture moved", lasting("bias", topic="lrf_pose",
        size=[0.3, 0.4, 0.0])),
    *of_both("noise x5", "people in the view, motors nearby", "noise", factor=5.0),
    *of_both("frozen", "the driver hangs, and sends on", "frozen"),
    *of_both("duplicates", "two paths of the network", "duplicates"),
    *of_both("reordered", "UDP", "reordered"),
    *of_both("burst", "the network stalls, then all comes at once", "burst"),
    *of_both("stamps 5 s ahead", "clocks not synchronised", "wrong_stamp", size=5.0),
    *of_both("stamps 0.5 s ahead", "clocks not synchronised", "wrong_stamp", size=0.5),
    *of_both("stamps 0.5 s behind", "clocks not synchronised", "wrong_stamp", size=-0.5),
    *of_both("stamps 5 s behind", "clocks not synchronised", "wrong_stamp", size=-5.0),
    *of_both("NaN", "a driver's division by zero", "nan"),
    *of_both("zero quaternion", "never filled in", "zero_quaternion"),
    row("fixes: zero quaternion, lrf_use_yaw", "never filled in, but needed",
        lasting("zero_quaternion", topic="lrf_pose"), localizer=("lrf_use_yaw:=true",)),
    *of_both("wrong frame", "a wrong configuration", "wrong_frame", frame="odom"),
    row("compass: degrees for radians", "a wrong unit",
        lasting("wrong_unit", topic="compass", factor=57.29578)),
    row("fixes: millimetres for metres", "a wrong unit",
        lasting("wrong_unit", topic="lrf_pose", factor=1000.0)),
    row("fixes: bad covariance, used", "never filled in",
        lasting("bad_covariance", topic="lrf_pose"),
        localizer=("lrf_use_message_covariance:=true",)),
    row("fixes: bad covariance, not used", "the same where it does not matter",
        lasting("bad_covariance", topic="lrf_pose")),
    row("compass: covariance -1", "an IMU that says it has no yaw",
        lasting("bad_covariance", topic="compass", variance=-1.0)),
    row("everything that measures is silent", "dead reckoning is left",
        *(lasting("dropout", topic=topic) for topic in BOTH)),
    row("clock: 30 s forward", "NTP sets the clock", once("clock_jump", size=30.0)),
    row("clock: 10 s back", "the same, or a recording loops", once("clock_jump", size=-10.0)),
    row("clock: 0.5 s back", "NTP sets the clock", once("clock_jump", size=-0.5)),
)  # fmt: skip


def command(name: str, parameters: Sequence[str]) -> list[str]:
    """Return the command line of a node; a shell's ignored SIGINT is not handed down."""
    given = [word for text in parameters for word in ("-p", text)]
    start = [sys.executable, "-m", "fnn_ekf_ros", name]
    return ["env", "--default-signal=INT", *start, "--ros-args", *given]


@contextmanager
def running(log: Path, arguments: Sequence[str]) -> Iterator[subprocess.Popen[bytes]]:
    """Run a process for the length of a block, ended by SIGINT; its output goes to a file."""
    with log.open("wb") as output:
        process = subprocess.Popen(arguments, stdout=output, stderr=subprocess.STDOUT)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.send_signal(signal.SIGINT)
            try:
                process.wait(timeout=PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def record(given: Row, folder: Path, rate: float) -> None:
    """Run a row's processes in a folder and record them until the robot's time is over.

    Raises:
        FnnEkfError: a node ended or did not come up.
    """
    timeline = folder / "faults.yaml"
    silent = [
        {"fault": "dropout", "topic": topic, "start": 0.0, "duration": SWITCHED_ON_S}
        for topic in TOPICS
    ]
    timeline.write_text(yaml.safe_dump([*silent, *map(dict, given.timeline)]))
    source = "ticks" if given.ticks else "joint_states"
    localizer = command("localizer", [
        *GEOMETRY, "use_sim_time:=true", f"encoder_source:={source}", *given.localizer,
    ])  # fmt: skip
    robot = command("fake_robot", [
        "publish_clock:=true", f"real_time_factor:={rate}", f"seed:={SEED}", "path:=round",
        f"faults_file:={timeline}", *given.robot,
    ])  # fmt: skip
    needed = round(END_S * 1e9) // TRUTH_INTERVAL_NS
    logs = {name: folder / f"{name}.log" for name in ("localizer", "fake_robot")}
    with (
        Recorder(folder / "run", RECORDED) as recorder,
        running(logs["localizer"], localizer) as node,
    ):
        others = {"/odom", "/localizer/noise", "/diagnostics"}
        there = lambda: all(recorder.publisher_count(topic) for topic in others)  # noqa: E731
        wait(there, recorder, [node], logs, PATIENCE_S)
        with running(logs["fake_robot"], robot) as hardware:
            patience_s = PATIENCE_S + 5.0 * END_S / rate
            whole = lambda: recorder.counts["/ground_truth"] >= needed  # noqa: E731
            wait(whole, recorder, [node, hardware], logs, patience_s)


def wait(
    condition: Callable[[], bool],
    recorder: Recorder,
    processes: Sequence[subprocess.Popen[bytes]],
    logs: dict[str, Path],
    patience_s: float,
) -> None:
    """Record until a condition holds.

    Raises:
        FnnEkfError: a process ended, or it took too long.
    """
    deadline = time.monotonic() + patience_s
    while not condition():
        recorder.spin_once(0.05)
        for name, process in zip(logs, processes, strict=False):
            if process.poll() is not None:
                said = logs[name].read_text(errors="replace").strip().splitlines()[-1:]
                raise FnnEkfError(f"{name} ended with {process.returncode}: {' '.join(said)}")
        if time.monotonic() > deadline:
            raise FnnEkfError(f"not done after {patience_s:g} s")


def run_row(given: Row, folder: Path, rate: float) -> Run:
    """Run a row in a folder, so many times as fast as real time, and return what was recorded.

    Raises:
        FnnEkfError: it did not run.
    """
    folder.mkdir(parents=True)
    profile = folder / "discovery.xml"
    profile.write_text(DISCOVERY)
    os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(profile)
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_LOG_DIR"] = str(folder / "log")
    record(given, folder, rate)
    return read_run(folder / "run", given)


def folder_of(given: Row) -> Path:
    """Return where a row is recorded."""
    return OUT / re.sub(r"[^a-z0-9]+", "-", given.name.lower()).strip("-")


def tried(number: int, domain: int, rate: float, made_by: str) -> str:
    """Run a row of the matrix, several times if need be; return what was wrong, or nothing."""
    folder = folder_of(ROWS[number])
    if ROWS[number].ticks:
        rate *= TICKS_SHARE
    for attempt in range(ATTEMPTS):
        shutil.rmtree(folder, ignore_errors=True)
        os.environ["ROS_DOMAIN_ID"] = str(1 + (domain + 37 * attempt) % 90)
        try:
            run_row(ROWS[number], folder, rate / 1.5**attempt)
        except FnnEkfError as error:
            reason = str(error)
        else:
            (folder / MADE_BY).write_text(made_by)
            return ""
    return reason


def run_all(numbers: Sequence[int], jobs: int, rate: float) -> None:
    """Run rows of the matrix, each in a process and on a domain of its own; show progress."""
    began = time.monotonic()
    made_by = version()  # of the code as it is now
    spawn = multiprocessing.get_context("spawn")  # rclpy does not survive a fork
    with ProcessPoolExecutor(jobs, mp_context=spawn, max_tasks_per_child=1) as pool:
        waiting = {pool.submit(tried, n, os.getpid() + n, rate, made_by): n for n in numbers}
        for done, future in enumerate(as_completed(waiting), start=1):
            reason = future.result()
            print(
                f"{done:3d} of {len(numbers)}, {time.monotonic() - began:4.0f} s: "
                f"{ROWS[waiting[future]].name}{': ' + reason if reason else ''}",
                flush=True,
            )


def write() -> int:
    """Write the table and the picture of what is recorded; return how many rows are not."""
    notes = {path.read_text() for path in OUT.glob(f"*/{MADE_BY}")}
    runs: dict[str, Run | str] = {}
    for given in ROWS:
        recording = folder_of(given) / "run"
        try:
            runs[given.name] = read_run(recording, given) if recording.exists() else "no recording"
        except FnnEkfError as error:
            runs[given.name] = str(error)
    lines: list[tuple[Row, Verdict | str]] = []
    for given in ROWS:
        run, usual = runs[given.name], runs[UNDISTURBED[given.ticks].name]
        without = runs[given.without] if given.without else usual
        if isinstance(run, str):
            lines.append((given, run))
        elif isinstance(usual, str) or isinstance(without, str):
            lines.append((given, "the run to compare it with did not run"))
        else:
            lines.append((given, judge(given, run, usual, without)))
    made_by = " for some rows, ".join(sorted(notes))
    write_text(TABLE, fault_tables.document(lines, runs[ROWS[0].name], made_by, PICTURE))
    fault_tables.draw(TABLE.with_name(PICTURE), [(given, runs[given.name]) for given in ROWS])
    return sum(isinstance(verdict, str) for _, verdict in lines)


def main() -> int:
    """Run the matrix, or some rows of it, and write what came of it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=1, help="rows at a time (1)")
    rate = f"times real time ({RATE:g}); a row that is too fast for the machine is run slower"
    parser.add_argument("--rate", type=float, default=RATE, help=rate)
    only = "run the rows with one of these in their names; the others are as recorded before"
    parser.add_argument("--only", nargs="+", metavar="WORD", help=only)
    recorded = "run nothing: write what the last recordings hold"
    parser.add_argument("--recorded", action="store_true", help=recorded)
    arguments = parser.parse_args()
    OUT.mkdir(parents=True, exist_ok=True)
    if not arguments.recorded:
        words = arguments.only or [""]
        numbers = [n for n, r in enumerate(ROWS) if any(word in r.name for word in words)]
        run_all(numbers, arguments.jobs, arguments.rate)
    failed = write()
    print(f"{TABLE.relative_to(ROOT)}: {len(ROWS)} rows, {failed} failed")
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
