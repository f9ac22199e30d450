# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Builds with colcon (ament_python) and with plain pip; package.xml holds the version."""

import xml.etree.ElementTree as ElementTree
from pathlib import Path

from setuptools import find_packages, setup

NAME = "fnn_ekf_ros"
HERE = Path(__file__).resolve().parent
MANIFEST = ElementTree.parse(HERE / "package.xml").getroot()
# command name -> name of its function in cli.py
COMMANDS = {
    "localizer": "localizer",
    "fake_robot": "fake_robot",
    "simulate": "simulate",
    "play": "play",
    "replay": "replay",
    "import-csv": "import_csv",
    "doctor": "doctor",
    "evaluate": "evaluate",
    "compare": "compare",
    "tune": "tune",
    "train": "train",
    "study": "study",
}
# folder, here and below share/fnn_ekf_ros -> its files
SHARED = {
    "launch": ["localizer.launch.py", "demo.launch.py"],
    "config": [
        "localizer.yaml",
        "fake_robot.yaml",
        "faults_example.yaml",
        "localizer.rviz",
        "foxglove_layout.json",
        "plotjuggler_layout.xml",
    ],
}

setup(
    name=NAME,
    version=MANIFEST.findtext("version"),
    description=" ".join(MANIFEST.findtext("description").split()),
    license=MANIFEST.findtext("license"),
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={
        NAME: ["py.typed"],
        f"{NAME}.membership": ["*.yaml"],
        f"{NAME}.reports": ["*.j2"],
    },
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        *(
            (f"share/{NAME}/{folder}", [f"{folder}/{file}" for file in files])
            for folder, files in SHARED.items()
        ),
    ],
    python_requires=">=3.11",
    # rclpy and the message packages come with ROS, never from here.
    install_requires=["numpy>=1.26", "PyYAML>=6.0", "rosbags>=0.11.9,<0.12"],
    extras_require={
        "tools": ["argcomplete>=3.1", "jinja2>=3.1", "matplotlib>=3.8", "tqdm>=4.66"],
        "test": ["pytest>=8", "hypothesis>=6.100"],
    },
    zip_safe=False,
    entry_points={
        "console_scripts": [
            f"{command} = {NAME}.cli:{function}" for command, function in COMMANDS.items()
        ]
    },
)
