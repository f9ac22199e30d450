# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Reading of YAML as ROS reads it; the only place that parses YAML."""

import re
from pathlib import Path
from typing import Any

import yaml

from fnn_ekf_ros.errors import FnnEkfError
from fnn_ekf_ros.files.text_files import read_text


class _Loader(yaml.SafeLoader):
    """Reads 1e-3 (without a point) as a number, as ROS does and YAML 1.1 does not."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("aliases (*name) are not supported, as in ROS")
        return super().compose_node(parent, index)


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


class _UniqueKeysLoader(_Loader):
    """Refuses a key that stands twice in a mapping, where YAML would keep the last."""

    def construct_mapping(self, node: Any, deep: bool = False) -> Any:
        keys = [self.construct_object(key, deep=True) for key, _ in node.value]
        for key in keys:
            if keys.count(key) > 1:
                line = node.start_mark.line + 1
                raise yaml.YAMLError(f"key '{key}' stands twice in the entry of line {line}")
        return super().construct_mapping(node, deep)


def read_yaml(path: Path, what: str, kind: type[FnnEkfError]) -> Any:
    """Return the content of a YAML file.

    Args:
        path: the file.
        what: what it is, for the error's first words.
        kind: the error to raise.

    Raises:
        FnnEkfError: it cannot be read, or is no YAML that ROS would read.
    """
    return load_yaml(read_text(path, what, kind), f"{what} '{path}'", kind)


def load_yaml(text: str, what: str, kind: type[FnnEkfError], *, unique_keys: bool = False) -> Any:
    """Return the content of a YAML text.

    Args:
        text: a single document.
        what: what it is, for the error's first words.
        kind: the error to raise.
        unique_keys: refuse a key that stands twice in a mapping; ROS takes the last.

    Raises:
        FnnEkfError: it is not YAML, or no YAML that ROS would read.
    """
    try:
        loader = _UniqueKeysLoader if unique_keys else _Loader
        return yaml.load(text, loader)  # noqa: S506 (both are SafeLoaders)
    except RecursionError:
        raise kind(f"{what} is nested too deeply") from None
    except Exception as error:  # PyYAML's constructors raise ValueError and others
        reason = " ".join(str(error).split())
        raise kind(f"{what} is not YAML: {reason[:200]}") from None
