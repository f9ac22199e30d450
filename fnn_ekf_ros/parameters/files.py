"""Parameter files in ROS form, and `-p name:=value` as ROS writes it."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from fnn_ekf_ros.parameters.schema import ParameterError, Parameters, fields_of


class _RosLoader(yaml.SafeLoader):
    """Reads 1e-3 (without a point) as a number, as ROS does and YAML 1.1 does not."""


_RosLoader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"^[-+]?[0-9]+(\.[0-9]*)?[eE][-+]?[0-9]+$"),
    list("-+0123456789"),
)


def read_parameter_file(path: Path, node_name: str) -> dict[str, Any]:
    """Return the parameters that a ROS parameter file holds for a node, in any namespace.

    Args:
        path: YAML file; sections are named by the node (`/**`, `/**/NAME`, `NAME`, ...).
        node_name: the node's name, without namespace.

    Raises:
        ParameterError: the file cannot be read or is not in ROS form.
    """
    try:
        content = yaml.load(path.read_text(encoding="utf-8"), _RosLoader)  # noqa: S506 (safe)
    except OSError as error:
        raise ParameterError(f"parameter file '{path}': {error.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        reason = " ".join(str(error).split())
        raise ParameterError(f"parameter file '{path}' is not YAML: {reason}") from None
    form = f"'/**/{node_name}:', under it 'ros__parameters:', under it the parameters"
    if not isinstance(content, dict):
        raise ParameterError(f"parameter file '{path}' holds no sections: expected {form}")
    values: dict[str, Any] = {}
    named = []
    for name, section in _sections("", content):
        if not isinstance(section, dict):
            raise ParameterError(f"parameter file '{path}', section '{name}': expected {form}")
        named.append(name)
        if name.rsplit("/", 1)[-1] in {node_name, "*", "**"}:
            values.update(_flatten("", section))
    if not named:
        raise ParameterError(f"parameter file '{path}' has no 'ros__parameters': expected {form}")
    return values


def parse_assignment(text: str) -> tuple[str, Any]:
    """Return name and value of `name:=value`, the value read as YAML.

    Raises:
        ParameterError: the text has another form.
    """
    name, separator, value = text.partition(":=")
    if not separator or not name:
        raise ParameterError(f"-p {text}: expected name:=value")
    try:
        return name, yaml.load(value, _RosLoader)  # noqa: S506 (a SafeLoader)
    except yaml.YAMLError:
        raise ParameterError(f"-p {text}: '{value}' is not YAML") from None


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
    return str(yaml.safe_dump(value, default_flow_style=True)).splitlines()[0]


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
