#!/bin/sh
# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

# make_venv.sh PYTHON VENV: a virtual environment with all that the project needs.
# Where a ROS 2 installation is sourced, its rclpy and messages are used; elsewhere the wheels.
set -eu
python=$1
venv=$2

recent=$("$python" -c 'import sys; print(sys.version_info >= (3, 11))') || {
    echo "cannot run '$python': expected a Python interpreter, as in make PYTHON=python3.12" >&2
    exit 1
}
if [ "$recent" != True ]; then
    echo "'$python' is too old: expected Python 3.11 or later" >&2
    exit 1
fi
if "$python" -c 'import rclpy' 2>/dev/null; then
    echo "using the ROS 2 installation that is sourced (ROS_DISTRO=${ROS_DISTRO:-unknown})"
    "$python" -m venv --clear --system-site-packages "$venv"
    ros=
else
    "$python" -m venv --clear "$venv" || {
        echo "$python cannot make virtual environments: install its venv package" >&2
        exit 1
    }
    ros="-r requirements-ros.txt"
fi
# shellcheck disable=SC2086  # $ros is two words or none
"$venv/bin/python" -m pip install --disable-pip-version-check --progress-bar off --quiet \
    -r requirements.txt $ros
"$venv/bin/python" -m pip install --disable-pip-version-check --quiet \
    --no-deps --no-build-isolation -e .
