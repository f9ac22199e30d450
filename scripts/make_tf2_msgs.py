# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""make_tf2_msgs.py FOLDER: builds tf2_msgs against the ROS wheels, for the tests of /tf.

tf2_msgs comes with every ROS installation, but not as a wheel. Needs cmake, a compiler and
requirements-tests.txt. The wheels' cmake files name the Python that they were made with: a copy of
them gets the one that is here.
"""

import os
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

import numpy as np

PACKAGE = """\
<package format="3">
  <name>tf2_msgs</name>
  <version>0.36.0</version>
  <description>The one message that the tests need.</description>
  <maintainer email="none@example.com">none</maintainer>
  <license>BSD</license>
  <buildtool_depend>ament_cmake</buildtool_depend>
  <buildtool_depend>rosidl_default_generators</buildtool_depend>
  <depend>geometry_msgs</depend>
  <member_of_group>rosidl_interface_packages</member_of_group>
</package>
"""
"""Content of package.xml."""
CMAKE = """\
cmake_minimum_required(VERSION 3.16)
project(tf2_msgs)
find_package(ament_cmake REQUIRED)
find_package(geometry_msgs REQUIRED)
find_package(rosidl_default_generators REQUIRED)
rosidl_generate_interfaces(${PROJECT_NAME} "msg/TFMessage.msg" DEPENDENCIES geometry_msgs)
ament_package()
"""
"""Content of CMakeLists.txt."""
MESSAGE = "geometry_msgs/TransformStamped[] transforms\n"
"""Content of msg/TFMessage.msg."""


def copy_of_wheels(folder: Path) -> None:
    """Make a prefix that has the environment's libraries and a mended copy of its cmake files."""
    environment = Path(sys.prefix)
    folder.mkdir(parents=True)
    for name in ("include", "lib", "bin"):
        (folder / name).symlink_to(environment / name)
    shutil.copytree(environment / "share", folder / "share")
    for file in (folder / "share").rglob("*.cmake"):
        text = file.read_text(encoding="utf-8")
        mended = re.sub(r"/opt/python/[^;\"]*/numpy/_core/include", np.get_include(), text)
        mended = re.sub(
            r"/opt/python/[^;\"]*/include/python[0-9.]+", sysconfig.get_path("include"), mended
        )
        if mended != text:
            file.write_text(mended, encoding="utf-8")


def main() -> None:
    """Build into FOLDER/install; there it appears only once it is complete."""
    folder = Path(sys.argv[1]).absolute()
    work = folder / "work"
    shutil.rmtree(work, ignore_errors=True)
    copy_of_wheels(work / "wheels")
    source, build, ready = work / "source", work / "build", work / "install"
    (source / "msg").mkdir(parents=True)
    (source / "package.xml").write_text(PACKAGE, encoding="utf-8")
    (source / "CMakeLists.txt").write_text(CMAKE, encoding="utf-8")
    (source / "msg" / "TFMessage.msg").write_text(MESSAGE, encoding="utf-8")
    environment = os.environ | {
        "AMENT_PREFIX_PATH": str(work / "wheels"),
        "CMAKE_PREFIX_PATH": str(work / "wheels"),
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    }
    configure = [
        "cmake", "-S", source, "-B", build, "-Wno-dev", "-DBUILD_TESTING=OFF",
        *(["-G", "Ninja"] if shutil.which("ninja") else []),
        f"-DCMAKE_INSTALL_PREFIX={ready}",
        f"-DPython3_EXECUTABLE={sys.executable}",
        "-DCMAKE_INSTALL_RPATH=$ORIGIN;$ORIGIN/../../..",
    ]  # fmt: skip
    for command in (configure, ["cmake", "--build", build, "--target", "install"]):
        ended = subprocess.run(
            command, env=environment, capture_output=True, text=True, check=False
        )
        if ended.returncode:
            sys.exit(f"{ended.stdout[-2000:]}{ended.stderr[-2000:]}")
    ready.rename(folder / "install")
    shutil.rmtree(work)


main()
