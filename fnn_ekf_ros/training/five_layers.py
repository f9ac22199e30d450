# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The five-layer network of `core.fuzzy` for steepest descent."""

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import FuzzySets, infer, infer_gradient
from fnn_ekf_ros.training.descent import LearningNetwork

UNITS_PER_SCALE = 15.0
"""Units of a membership file per scale of the training set. The scale is the spread of D where R is
right; the paper's initial P and N have a membership of one half at 17 and 13, near that spread."""
SMALLEST_SLOPE = 0.01
"""Smallest absolute slope [1 / scale of the training set]. Slopes keep their signs: P and D fall, N
and I rise, and the inverses of D and I exist."""
SMALLEST_ZERO_WIDTH = 0.01
"""Smallest width of Z [scales of the training set]: width 0 has no derivative."""
JOINT_SCALE = 0.5
"""Scale of u and of the change while mode joint's network learns [log variance]: with it both are
of order 1."""

_SLOPES = [index for index, name in enumerate(FuzzySets._fields) if name.endswith("_slope")]
"""Places of the slopes among the parameters."""
_MAINTAIN_WIDTH = FuzzySets._fields.index("maintain_width")
"""Place of the width of M among the parameters."""
_ZERO_WIDTH = FuzzySets._fields.index("zero_width")
"""Place of the width of Z among the parameters."""


def as_sets(parameters: FloatArray) -> FuzzySets:
    """Return the sets with a vector of parameters `(12,)` in the order of `FuzzySets`."""
    return FuzzySets(*parameters.tolist())


def five_layers(start: FuzzySets) -> LearningNetwork:
    """Return the network with inputs D and outputs dR, both in the sets' unit.

    Args:
        start: the sets before learning; the signs of their slopes are kept.
    """
    signs = np.where(np.array(start)[_SLOPES] < 0.0, -1.0, 1.0)

    def feasible(p: FloatArray) -> FloatArray:
        kept = p.copy()
        kept[_SLOPES] = signs * np.maximum(signs * p[_SLOPES], SMALLEST_SLOPE)
        kept[_MAINTAIN_WIDTH] = max(p[_MAINTAIN_WIDTH], 0.0)
        kept[_ZERO_WIDTH] = max(p[_ZERO_WIDTH], SMALLEST_ZERO_WIDTH)
        return kept

    return LearningNetwork(
        output=lambda p, mismatch: infer(as_sets(p), mismatch).change,
        gradient=lambda p, mismatch: infer_gradient(as_sets(p), mismatch),
        feasible=feasible,
    )


def odd_layers(start: FuzzySets) -> LearningNetwork:
    """Return the network of mode joint, with inputs -u and outputs in `JOINT_SCALE`.

    After each step P is made the mirror image of N, and D that of I; Z and M are centered at 0. So
    the network stays an odd function. With an odd training set it would stay odd without this,
    except for rounding.

    Args:
        start: the sets before learning.
    """
    layers = five_layers(start)

    def feasible(p: FloatArray) -> FloatArray:
        return np.array(mirrored(as_sets(layers.feasible(p))))

    return LearningNetwork(output=layers.output, gradient=layers.gradient, feasible=feasible)


def mirrored(sets: FuzzySets) -> FuzzySets:
    """Return the nearest sets whose network is odd."""
    s = sets
    antecedent_slope = 0.5 * (s.negative_slope - s.positive_slope)
    antecedent_center = 0.5 * (s.negative_center - s.positive_center)
    consequent_slope = 0.5 * (s.increase_slope - s.decrease_slope)
    consequent_center = 0.5 * (s.increase_center - s.decrease_center)
    return sets._replace(
        positive_slope=-antecedent_slope,
        positive_center=-antecedent_center,
        negative_slope=antecedent_slope,
        negative_center=antecedent_center,
        decrease_slope=-consequent_slope,
        decrease_center=-consequent_center,
        increase_slope=consequent_slope,
        increase_center=consequent_center,
        maintain_center=0.0,
        zero_center=0.0,
    )


def joint_network(sets: FuzzySets, change_limit: float) -> FuzzyNetwork:
    """Return mode joint's sets as a membership file holds them, in numbers of six digits.

    Args:
        sets: the sets in `JOINT_SCALE`.
        change_limit: universe of the consequents [log variance].
    """
    ours = in_unit(sets, 1.0 / JOINT_SCALE)
    return FuzzyNetwork(
        sets=FuzzySets(*map(_six_digits, ours)),
        position_unit=1.0,
        yaw_unit=1.0,
        change_limit=change_limit,
    )


def first_sets(network: FuzzyNetwork) -> FuzzySets:
    """Return the sets from which descent starts, in scales of the training set.

    The numbers of the file are used without its units, which the training set determines. Two of
    the paper's initial sets have no usable gradient and are replaced: a crisp D (slope 0) has no
    inverse and no derivative with respect to its slope, and starts as the mirror image of I; a Z
    that is narrower than the spread of D where R is right hardly fires, and starts with that width.
    """
    sets = network.sets
    replaced = sets._replace(
        decrease_slope=sets.decrease_slope or -sets.increase_slope,
        zero_width=max(sets.zero_width, UNITS_PER_SCALE),
    )
    return in_unit(replaced, UNITS_PER_SCALE)


def learned_network(
    sets: FuzzySets,
    position_scale: float,
    yaw_scale: float,
    change_scale: float,
    change_limit: float,
) -> FuzzyNetwork:
    """Return learned sets as a membership file holds them, in numbers of six digits.

    Args:
        sets: the sets in scales of the training set.
        position_scale: scale of D in position rows [m^2].
        yaw_scale: scale of D in yaw rows [rad^2].
        change_scale: scale of dR [scales of D].
        change_limit: universe of the consequents [the file's unit].
    """
    ours = in_unit(_with_change_scaled(sets, change_scale), 1.0 / UNITS_PER_SCALE)
    return FuzzyNetwork(
        sets=FuzzySets(*map(_six_digits, ours)),
        position_unit=_six_digits(position_scale / UNITS_PER_SCALE),
        yaw_unit=_six_digits(yaw_scale / UNITS_PER_SCALE),
        change_limit=change_limit,
    )


def in_unit(sets: FuzzySets, unit: float) -> FuzzySets:
    """Return the same functions of arguments in a unit that is `unit` times as large."""
    return FuzzySets(
        *(
            value * unit if name.endswith("_slope") else value / unit
            for name, value in sets._asdict().items()
        )
    )


def _with_change_scaled(sets: FuzzySets, factor: float) -> FuzzySets:
    """Return sets whose output is `factor` times as large."""
    return sets._replace(
        decrease_slope=sets.decrease_slope / factor,
        decrease_center=sets.decrease_center * factor,
        increase_slope=sets.increase_slope / factor,
        increase_center=sets.increase_center * factor,
        maintain_center=sets.maintain_center * factor,
        maintain_width=sets.maintain_width * factor,
    )


def _six_digits(value: float) -> float:
    return float(f"{value:.6g}")
