# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Real nodes in processes of their own, on a ROS domain of their own."""

import ctypes
import itertools
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import pytest
import rclpy
from commands import HEARS_SIGINT
from places import ROOT
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rosgraph_msgs.msg import Clock

from fnn_ekf_ros.membership.files import networks_for
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.parameters.schema import build
from fnn_ekf_ros.ros.localizer import LocalizerNode
from fnn_ekf_ros.ros.runtime import parameters_from_ros

PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
PATIENCE_S = 60.0
PAPERS_ROBOT = [
    "-p", "wheel_radius:=0.025", "-p", "wheel_separation:=0.6",
    "-p", "encoder_counts_per_revolution:=500.0",
]  # fmt: skip
TESTS = itertools.count()
"""Numbers the tests of this process."""


def prefix_of_workspace() -> Path | None:
    """Return where colcon has installed the package, if its environment is active."""
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix and (Path(prefix) / "lib" / "fnn_ekf_ros").is_dir():
            return Path(prefix)
    return None


class Processes:
    """Starts the package's executables the way `ros2 run` does, and ends them."""

    def __init__(self, folder: Path, domain: int) -> None:
        self.folder = folder
        self.environment = {
            **os.environ,
            "ROS_DOMAIN_ID": str(domain),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "ROS_LOG_DIR": str(folder / "log"),
            "PYTHONUNBUFFERED": "1",
            PROFILES: str(ROOT / "test" / "support" / "discovery.xml"),
        }
        if prefix_of_workspace() is None:
            self.environment["PYTHONPATH"] = str(ROOT)
        self._running: list[subprocess.Popen[str]] = []

    def command(self, name: str, *arguments: object) -> list[str]:
        prefix = prefix_of_workspace()
        head = (
            [sys.executable, "-m", "fnn_ekf_ros", name]
            if prefix is None
            else [str(prefix / "lib" / "fnn_ekf_ros" / name)]
        )
        return head + [str(argument) for argument in arguments]

    def start(self, name: str, *arguments: object) -> subprocess.Popen[str]:
        """Start a node in the background; its output goes to files."""
        log = self.folder / f"{name}-{len(self._running)}"
        with (log.with_suffix(".out")).open("w") as out, (log.with_suffix(".err")).open("w") as err:
            process = subprocess.Popen(
                [*HEARS_SIGINT, *self.command(name, *arguments)],
                env=self.environment, stdout=out, stderr=err,
                text=True, cwd=self.folder,
            )  # fmt: skip
        process.log = log  # type: ignore[attr-defined]
        self._running.append(process)
        return process

    def run(self, name: str, *arguments: object) -> subprocess.CompletedProcess[str]:
        """Run a command to its end."""
        return subprocess.run(
            self.command(name, *arguments), env=self.environment, capture_output=True, text=True,
            timeout=300.0, cwd=self.folder,
        )  # fmt: skip

    def stop(self, process: subprocess.Popen[str], number: int = signal.SIGINT) -> str:
        """End a node by a signal; check its exit; return what it wrote."""
        process.send_signal(number)
        code = process.wait(timeout=PATIENCE_S)
        text = self.output(process)
        assert code == 0, text
        assert "Traceback" not in text
        return text

    def output(self, process: subprocess.Popen[str]) -> str:
        log: Path = process.log  # type: ignore[attr-defined]
        return log.with_suffix(".out").read_text() + log.with_suffix(".err").read_text()

    def kill_all(self) -> None:
        for process in self._running:
            if process.poll() is None:
                process.kill()
                process.wait()


class Bench:
    """A localizer in this process and a node beside it, with a /clock that the test sets."""

    def __init__(self, arguments: list[str]) -> None:
        rclpy.init(args=["", "--ros-args", "-p", "use_sim_time:=true", *arguments])
        parameters = build(LocalizerParameters, parameters_from_ros(NODE_NAME))
        self.node = Node("bench")
        self.localizer = LocalizerNode(parameters, networks_for(parameters))
        self.executor = SingleThreadedExecutor()
        self.executor.add_node(self.localizer)
        self.executor.add_node(self.node)
        self._clock = self.node.create_publisher(Clock, "/clock", 10)
        self.now_ns = 0

    def set_clock(self, now_ns: int) -> None:
        """Set ROS time and wait until the localizer knows it."""
        message = Clock()
        message.clock.sec, message.clock.nanosec = divmod(now_ns, 10**9)
        wait_until(lambda: self._clock.get_subscription_count() > 1, "the clock's subscribers")
        self._clock.publish(message)
        clock = self.localizer.get_clock()
        self.spin_until(lambda: clock.now().nanoseconds == now_ns, f"ROS time {now_ns}")
        self.now_ns = now_ns

    def spin_until(self, condition: Callable[[], Any], what: str) -> None:
        wait_until(lambda: condition() or self.executor.spin_once(timeout_sec=0.02), what)

    def call(self, kind: Any, name: str, request: Any) -> Any:
        """Call a service and return its response."""
        client = self.node.create_client(kind, name)
        self.spin_until(client.service_is_ready, f"service {name}")
        future = client.call_async(request)
        self.spin_until(future.done, f"answer of {name}")
        return future.result()

    def close(self) -> None:
        if not rclpy.ok():
            return
        self.executor.shutdown()
        self.localizer.destroy_node()
        self.node.destroy_node()
        rclpy.shutdown()


def wait_until(condition: Callable[[], Any], what: str, patience_s: float = PATIENCE_S) -> None:
    """Call a condition, which should spin, until it holds."""
    deadline = time.monotonic() + patience_s
    while not condition():
        assert time.monotonic() < deadline, f"waited {patience_s:g} s for {what}"


@pytest.fixture
def patiently() -> Callable[..., None]:
    return wait_until


@pytest.fixture
def domain() -> int:
    """A domain of this test's own, in the range that is safe with every kernel.

    Nodes that were killed at the end of a test stay known on their domain for seconds.
    """
    return 1 + (os.getpid() + next(TESTS)) % 90


@pytest.fixture
def processes(tmp_path: Path, domain: int) -> Iterator[Processes]:
    started = Processes(tmp_path, domain)
    yield started
    started.kill_all()


@pytest.fixture
def ros_environment(monkeypatch: pytest.MonkeyPatch, processes: Processes) -> None:
    """The same domain for nodes in this process."""
    for name in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOG_DIR", PROFILES):
        monkeypatch.setenv(name, processes.environment[name])


@pytest.fixture
def bench(ros_environment: None) -> Iterator[Callable[..., Bench]]:
    """Makes a bench from ROS arguments."""
    opened: list[Bench] = []

    def make(*arguments: str) -> Bench:
        opened.append(Bench([*PAPERS_ROBOT, *arguments]))
        return opened[-1]

    yield make
    for each in opened:
        each.close()


def reason_without_tf2_msgs() -> str:
    """Return why tf2_msgs cannot be built here; empty if it can."""
    if shutil.which("cmake") is None or not any(map(shutil.which, ("cc", "gcc", "clang"))):
        return "no tf2_msgs, and no cmake and compiler to build it with"
    if find_spec("ament_package") is None:
        return "no tf2_msgs, and no requirements-tests.txt to build it with (make test)"
    return ""


@pytest.fixture(scope="session")
def tf2_msgs() -> None:
    """Makes tf2_msgs importable: built once, into build/, where no ROS installation has it."""
    if find_spec("tf2_msgs") is not None:
        return
    folder = ROOT / "build" / "tf2_msgs"
    installed = folder / "install"
    if not installed.is_dir():
        reason = reason_without_tf2_msgs()
        if reason:
            pytest.skip(reason)
        made = subprocess.run(
            [sys.executable, ROOT / "scripts" / "make_tf2_msgs.py", folder],
            capture_output=True, text=True,
        )  # fmt: skip
        assert made.returncode == 0, made.stderr
    (packages,) = installed.glob("lib/python*/site-packages")
    libraries = installed / "lib"
    sys.path.append(str(packages))
    # The loader has read LD_LIBRARY_PATH already, but finds what is loaded.
    for library in sorted(libraries.glob("*.so")):
        ctypes.CDLL(str(library), mode=ctypes.RTLD_GLOBAL)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Live tests are slow, each of them."""
    for item in items:
        if item.get_closest_marker("live") is not None:
            item.add_marker(pytest.mark.slow)
