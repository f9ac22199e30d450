# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Parameter files in ROS form, and `-p name:=value` as ROS writes it."""

import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from fnn_ekf_ros.files.yaml_text import load_yaml, read_yaml
from fnn_ekf_ros.parameters.schema import ParameterError, Parameters, fields_of

_MISREAD = {"true", "false", "yes", "no", "on", "off", "null", "y", "n"}
"""Words that YAML reads as truth values or as nothing, so that they are written in quotes."""


def read_parameter_file(path: Path, node_name: str, *, has_section: bool = True) -> dict[str, Any]:
    """Return the parameters that a ROS parameter file holds for a node, in any namespace.

    Args:
        path: YAML file; sections are named by the node (`/**`, `/**/NAME`, `NAME`, ...).
        node_name: the node's name, without namespace.
        has_section: whether a file without a section for the node is refused; a node that runs
            under another name, or with one file for all nodes, takes it.

    Raises:
        ParameterError: the file cannot be read, is not in ROS form or is for other nodes only.
    """
    content = read_yaml(path, "parameter file", ParameterError)
    form = f"'/**/{node_name}:', under it 'ros__parameters:', under it the parameters"
    if not isinstance(content, dict):
        raise ParameterError(f"parameter file '{path}' holds no sections: expected {form}")
    values: dict[str, Any] = {}
    named, matched = [], False
    robots: set[str] = set()
    for name, section in _sections("", content):
        if not isinstance(section, dict) or not name:
            raise ParameterError(f"parameter file '{path}', section '{name}': expected {form}")
        named.append(name)
        if name.rsplit("/", 1)[-1] in {node_name, "*", "**"}:
            matched = True
            values.update(_flatten("", section))
            if "*" not in name:
                robots.add(name)
    if not named:
        raise ParameterError(f"parameter file '{path}' has no 'ros__parameters': expected {form}")
    if has_section and not matched:
        raise ParameterError(
            f"parameter file '{path}' has no section for {node_name}, but for "
            f"{', '.join(sorted(named))}: expected '/**/{node_name}:' or '/**:'; rename the section"
        )
    if len(robots) > 1:
        raise ParameterError(
            f"parameter file '{path}' has sections for {' and '.join(sorted(robots))}: expected "
            "one, or a pattern such as /**"
        )
    return values


def parse_assignment(text: str) -> tuple[str, Any]:
    """Return name and value of `name:=value`, the value read as YAML.

    Raises:
        ParameterError: the text has another form.
    """
    name, separator, value = text.partition(":=")
    if not separator or not name:
        raise ParameterError(f"-p {text}: expected name:=value")
    return name, load_yaml(value, f"-p {name}:= value '{value[:80]}'", ParameterError)


def refuse_what_ros_refuses(values: Mapping[str, Any]) -> None:
    """Refuse values that ROS itself cannot take, without saying which.

    Raises:
        ParameterError: a value that is missing, or a list of mixed types.
    """
    for name, value in values.items():
        if value is None or value == []:
            raise ParameterError(f"parameter '{name}' has no value: give it one or leave it out")
        if isinstance(value, list) and len({type(entry) for entry in value}) > 1:
            raise ParameterError(
                f"parameter '{name}' is {value}: expected a list of one type, as ROS does; "
                "write each number with a point"
            )


def render_parameter_file(
    kind: type[Parameters], values: Mapping[str, Any], node_name: str, head: str = ""
) -> str:
    """Return a parameter file in ROS form that holds all parameters, each with its sentence.

    Args:
        kind: the parameter set.
        values: by name; what is left out gets its default. NaN stands for "not set".
        node_name: the section's node.
        head: comment lines for the top, without `#`.
    """
    lines = [f"# {line}".rstrip() for line in head.splitlines()]
    lines += [f"/**/{node_name}:", "  ros__parameters:"]
    for name, spec, default in fields_of(kind):
        unit = f" [{spec.unit.strip('[]')}]" if spec.unit else ""
        lines += [f"    # {spec.doc}{unit}", f"    {name}: {_yaml(values.get(name, default))}"]
    return "\n".join(lines) + "\n"


def _yaml(value: Any) -> str:
    if isinstance(value, tuple):
        return "[" + ", ".join(_yaml(entry) for entry in value) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return ".nan" if value != value else repr(value)
    if isinstance(value, int):
        return str(value)
    return (
        json.dumps(value, ensure_ascii=False)
        if not value.isidentifier() or value.lower() in _MISREAD
        else str(value)
    )


def _sections(prefix: str, content: Mapping[Any, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in content.items():
        if key == "ros__parameters":
            yield prefix, value if value is not None else {}
        elif isinstance(value, dict):
            yield from _sections(f"{prefix}/{str(key).strip('/')}", value)


def _flatten(prefix: str, section: Mapping[Any, Any]) -> Iterator[tuple[str, Any]]:
    for key, value in section.items():
        if isinstance(value, dict):
            yield from _flatten(f"{prefix}{key}.", value)
        else:
            yield f"{prefix}{key}", value
