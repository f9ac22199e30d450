# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""A health summary in a few lines, as plain values, and as the parameters that would fit."""

from collections.abc import Iterable
from typing import Any

from fnn_ekf_ros.diagnostics.fault_isolation import Band
from fnn_ekf_ros.diagnostics.health import (
    MOST_ROWS,
    FoundNoise,
    HealthSummary,
    SensorHealth,
    StatusHealth,
    Verdict,
    honest_band,
)
from fnn_ekf_ros.diagnostics.messages import (
    MEASUREMENT_NOISES,
    PROCESS_NOISES,
    fitting_parameters,
)
from fnn_ekf_ros.diagnostics.travel import LARGEST_ERROR, TravelRatios
from fnn_ekf_ros.diagnostics.wheel_sizes import SIZE_KEYS
from fnn_ekf_ros.parameters.localizer import LocalizerParameters
from fnn_ekf_ros.timeline.events import Level, Sensor

LATE_START_S = 5.0
"""Time after the begin of a run from which on a start of the filter is late [s]: sensors need a few
seconds for their first message."""
VERDICTS = {
    Verdict.HONEST: "honest",
    Verdict.TOO_SURE: "too sure (readings are off by more than the filter expects)",
    Verdict.TOO_CAUTIOUS: "too cautious (readings are off by less than the filter expects)",
}
"""What a verdict means."""
SIGN_NAMES = ("left_inverted", "right_inverted")
"""Parameters of the signs of the counts."""
LEAST_EXPLAINED = 0.8
"""Share of the pose's displacement that wheels of wrong sizes still explain: simulated ones explain
98 % or more, those of wrong signs 67 % or less, because distance and rotation are mixed up."""
DIGITS = 4
"""Significant digits of a parameter that was found: more than it is known to."""
_FIX_NOISES = tuple(name for name in MEASUREMENT_NOISES if name.startswith("fixes"))
_YAW_NOISES = tuple(name for name in MEASUREMENT_NOISES if name not in _FIX_NOISES)


def health_lines(summary: HealthSummary, begin_ns: int, *, cause_known: bool = False) -> list[str]:
    """Return the summary in words: three lines if all is well, a dozen if nothing is.

    Args:
        summary: of a run.
        begin_ns: of the run [ns].
        cause_known: whether something else says what is wrong, better than what to check.
    """
    lines = [_headline(summary)]
    late_s = (summary.started_ns - begin_ns) * 1e-9
    if late_s > LATE_START_S:
        lines.append(f"  started {late_s:.0f} s after the begin: {summary.awaited}")
    troubled = [status for status in summary.statuses if status.message]
    troubled.sort(key=lambda status: (status.worst, status.share), reverse=True)
    lines += [f"  {_status(status)}" for status in troubled]
    lines.append(f"noise found (configured): {_noise(summary)}")
    lines.append(_nis(summary))
    if summary.lasting not in ("", "none"):
        lines.append(f"lasting errors: {summary.lasting}")
    lost = [text for sensor in summary.sensors if (text := _lost(sensor))]
    if lost:
        lines.append(f"not used: {'; '.join(lost)}")
    if summary.last_move is not None:
        last = summary.last_move
        lines.append(
            f"pose moved to the fixes: {_times(summary.moves)}, last by {last.distance:.1f} m and "
            f"{last.rotation:.2f} rad at {(last.stamp_ns - begin_ns) * 1e-9:.0f} s"
        )
    return lines if cause_known else [*lines, *(f"check {text}" for text in checks(summary))]


def checks(summary: HealthSummary) -> list[str]:
    """Return what to check: wheels that travel otherwise, or noise far above the configured one.

    Wheels that travel otherwise explain noise of any sensor.
    """
    travelled = _wrong_travel(summary.travel, summary.parameters)
    if travelled:
        return [travelled]
    found = []
    wheels = _suspicious(summary.noise, PROCESS_NOISES)
    if wheels:
        names = ["wheel_separation"]
        if wheels[0].name == PROCESS_NOISES[0]:  # not the rotation alone
            names = [*_size_names(summary.parameters), *names, *SIGN_NAMES]
        found.append(f"{', '.join(names)}, or raise process_noise_std: {_factors(wheels)}")
    fixes = _suspicious(summary.noise, _FIX_NOISES)
    if fixes:
        found.append(
            "the unit (m, rad) and the frame of the fixes, or raise measurement_noise_std: "
            f"{_factors(fixes)}"
        )
    yaws = _suspicious(summary.noise, _YAW_NOISES)
    if yaws:
        found.append(
            "the compass's mounting and axes (ENU, counter-clockwise), or raise "
            f"measurement_noise_std: {_factors(yaws)}"
        )
    return found


def found_parameters(summary: HealthSummary) -> dict[str, Any]:
    """Return the parameters that were found, by name: noise, and what diagnostics say would fit.

    Nothing fits a sensor whose noise is suspicious. The noise is within its bounds, as that in use
    is. Fixes that report their own covariance keep the configured noise, which is only
    what their scale refers to.
    """
    p = summary.parameters
    names = (*PROCESS_NOISES, *MEASUREMENT_NOISES)
    configured = (*p.process_noise_std, *p.measurement_noise_std, p.lrf_yaw_std)
    stds = dict(zip(names, configured, strict=True))
    stds |= {
        noise.name: noise.found
        for noise in summary.noise
        if not (p.lrf_use_message_covariance and noise.name in _FIX_NOISES)
    }
    low = (*p.process_noise_std_min, *p.measurement_noise_std_min, p.measurement_noise_std_min[2])
    high = (*p.process_noise_std_max, *p.measurement_noise_std_max, p.measurement_noise_std_max[2])
    distance, rotation, x, y, compass, fix_yaw = (
        min(max(float(f"{std:.{DIGITS}g}"), least), most)
        for std, least, most in zip(stds.values(), low, high, strict=True)
    )
    found: dict[str, Any] = {
        "process_noise_std": (distance, rotation),
        "measurement_noise_std": (x, y, compass),
        "lrf_yaw_std": fix_yaw,
    }
    if not p.lrf_use_yaw:
        del found["lrf_yaw_std"]
    doubtful = tuple(
        f"{sensor}_"
        for sensor, noises in ((Sensor.COMPASS, _YAW_NOISES), (Sensor.LRF_POSE, _FIX_NOISES))
        if _suspicious(summary.noise, noises)
    )
    fitting = {name: value for name, value in summary.fitting if not name.startswith(doubtful)}
    return found | fitting


def plain_summary(summary: HealthSummary) -> dict[str, Any]:
    """Return the summary as plain values, for JSON; units are in the names."""
    return {
        "healthy": summary.healthy,
        "started_s": summary.started_ns * 1e-9,
        "odom": summary.estimates,
        "statuses": {
            status.name: {
                "worst": status.worst.name,
                "last": status.last.name,
                "reports": status.reports,
                "share_of_warn": _share(status.warnings, status),
                "share_of_error": _share(status.errors, status),
                "longest_message": status.message,
                "share_of_longest_message": _share(status.message_reports, status),
            }
            for status in summary.statuses
        },
        "noise_std": {
            noise.name: {
                "unit": noise.unit,
                "configured": noise.configured,
                "found": noise.found,
            }
            for noise in summary.noise
        },
        "nis_per_degree_of_freedom": {
            nis.sensor: {
                "mean": nis.mean,
                "degrees_of_freedom": nis.rows,
                "honest_from": nis.band.low,
                "honest_to": nis.band.high,
                "verdict": nis.verdict,
            }
            for nis in summary.nis
        },
        "travel_of_pose_over_wheels": {
            name: None if ratio is None else ratio._asdict()
            for name, ratio in summary.travel._asdict().items()
        },
        "sensors": {
            each.sensor: {name: value for name, value in each._asdict().items() if name != "sensor"}
            for each in summary.sensors
        },
        "lasting_errors": summary.lasting,
        "moves": summary.moves,
        "checks": checks(summary),
        "found_parameters": found_parameters(summary),
    }


def _headline(summary: HealthSummary) -> str:
    troubled = [status for status in summary.statuses if status.message]
    if not summary.statuses:
        return "health: unknown, the run ended before the first report"
    if not summary.healthy:
        return "health: not good" + ("" if troubled else ", although every status was OK")
    return "health: good, " + (
        "each status OK nearly all the time" if troubled else "every status OK"
    )


def _status(status: StatusHealth) -> str:
    counts = {Level.ERROR: status.errors, Level.WARN: status.warnings}
    levels = " and ".join(
        f"{level.name} {_percent(_share(count, status))}"
        for level, count in counts.items()
        if count
    )
    at_end = " and at the end" if status.last is not Level.OK else ""
    values = dict(status.values)
    fitting = fitting_parameters(status.values).items()
    shown = [f"{name} {_shown(value)} would fit" for name, value in fitting]
    shown += [f"{key.removesuffix(' [%]')} {values[key]} %" for key in SIZE_KEYS if key in values]
    detail = f" ({', '.join(shown)})" if shown else ""
    return f"{status.name} {levels} of the time{at_end}: {status.message}{detail}"


def _noise(summary: HealthSummary) -> str:
    parts = []
    for noise in summary.noise:
        if summary.parameters.lrf_use_message_covariance and noise.name in _FIX_NOISES:
            parts.append(f"{noise.name} {noise.factor:.2g} times the reported one")
        else:
            parts.append(
                f"{noise.name} {_number(noise.found)} {noise.unit} ({_number(noise.configured)})"
            )
    return ", ".join(parts)


def _nis(summary: HealthSummary) -> str:
    """Return the line about NIS; a band that is as for many readings is named once."""
    usual = honest_band(MOST_ROWS)
    parts = []
    for nis in summary.nis:
        own = "" if nis.band == usual else f", of few readings: {_band(nis.band)}"
        parts.append(f"{nis.sensor} {_number(nis.mean)} {VERDICTS[nis.verdict]}{own}")
    parts += [
        f"{sensor.sensor} mostly late, see output_delay"
        for sensor in summary.sensors
        if sensor.sensor is not Sensor.ENCODERS and sensor.mostly_late
    ]
    said = ", ".join(parts) or "no reading"
    return f"NIS per degree of freedom (honest: {_band(usual)}): {said}"


def _band(band: Band) -> str:
    return f"{band.low:.2f} to {band.high:.2f}"


def _wrong_travel(travel: TravelRatios, parameters: LocalizerParameters) -> str:
    """Return which parameters to check for the travel of the wheels; empty if it is right."""
    wrong = {
        verb: ratio.ratio
        for verb, ratio in (("travels", travel.distance), ("rotates", travel.rotation))
        if ratio is not None and ratio.wrong
    }
    if not wrong:
        return ""
    names: list[str] = []
    distance, rotation = wrong.get("travels", 1.0), wrong.get("rotates", 1.0)
    mixed_up = travel.distance is not None and travel.distance.explained < LEAST_EXPLAINED
    if mixed_up or min(distance, rotation) < 0.0:
        names = [*SIGN_NAMES, "whether left and right are swapped"]
    else:
        width = distance / rotation
        if "travels" in wrong:
            radius = _number(parameters.wheel_radius * distance)
            names.append(f"wheel_radius ({radius} would fit)")
            names += _size_names(parameters)[1:]
        if abs(width - 1.0) > LARGEST_ERROR:
            separation = _number(parameters.wheel_separation * width)
            names.append(f"wheel_separation ({separation} would fit)")
    factors = " and ".join(f"{verb} {ratio:.2f}" for verb, ratio in wrong.items())
    return f"{', '.join(names)}: the pose {factors} times as far as the wheels count"


def _size_names(parameters: LocalizerParameters) -> list[str]:
    """Return the parameters of the distance per count."""
    if parameters.encoder_source == "ticks":
        return ["wheel_radius", "gear_ratio", "encoder_counts_per_revolution"]
    return ["wheel_radius"]


def _lost(sensor: SensorHealth) -> str:
    """Return which messages of a sensor did not correct the filter; empty if all did."""
    counts = (
        (sensor.rejected, f"rejected of {sensor.in_time}"),
        (sensor.refused, "refused"),
        (sensor.dropped, "dropped for their stamps"),
        (sensor.left_out, "left out"),
    )
    parts = [f"{count} {word}" for count, word in counts if count]
    return f"{sensor.sensor} {', '.join(parts)}" if parts else ""


def _suspicious(noise: Iterable[FoundNoise], names: tuple[str, ...]) -> list[FoundNoise]:
    return [each for each in noise if each.name in names and each.suspicious]


def _factors(noise: Iterable[FoundNoise]) -> str:
    factors = " and ".join(f"{each.name} noise {_number(each.factor)}" for each in noise)
    return f"{factors} times the configured one"


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"


def _share(count: int, status: StatusHealth) -> float:
    return count / status.reports if status.reports else 0.0


def _shown(value: bool | float | str) -> str:
    """Return a parameter's value as it is written in a file of parameters."""
    if isinstance(value, bool):
        return str(value).lower()
    return value if isinstance(value, str) else _number(value)


def _number(value: float) -> str:
    """Return a number with three digits, but no exponent for a large one."""
    return f"{value:.3g}" if value < 100.0 else f"{value:.0f}"


def _percent(share: float) -> str:
    return "less than 1 %" if share < 0.01 else f"{100.0 * share:.0f} %"
