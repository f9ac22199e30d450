"""The five-layer network of core.fuzzy as something that learns."""

import numpy as np

from fnn_ekf_ros.core.adaptation import FuzzyNetwork
from fnn_ekf_ros.core.arrays import FloatArray
from fnn_ekf_ros.core.fuzzy import FuzzySets, infer, infer_gradient
from fnn_ekf_ros.training.descent import LearningNetwork

UNITS_PER_SCALE = 15.0
"""Scales of the training set, counted in the unit of a membership file. The paper's initial P and
N are half true at 17 and 13: so that they are where the filter's D is when all is right."""
SMALLEST_SLOPE = 0.01
"""No slope falls below this in size or changes its sign, where inputs are of order 1: P and D
keep falling, N and I rising, and the inverses of D and I exist."""
SMALLEST_ZERO_WIDTH = 0.01
"""Z stays at least so wide, where inputs are of order 1."""
JOINT_SCALE = 0.5
"""u and change that count as one while mode joint's network learns [log variance]."""

_SLOPES = [index for index, name in enumerate(FuzzySets._fields) if name.endswith("_slope")]
_MAINTAIN_WIDTH = FuzzySets._fields.index("maintain_width")
_ZERO_WIDTH = FuzzySets._fields.index("zero_width")


def as_sets(parameters: FloatArray) -> FuzzySets:
    """Return a vector of parameters `(12,)` by their names."""
    return FuzzySets(*parameters.tolist())


def five_layers(start: FuzzySets) -> LearningNetwork:
    """Return the network with inputs D and outputs dR, both in the sets' unit.

    Args:
        start: the sets that learn first; their slopes' signs are kept.
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

    P is kept the mirror image of N, D that of I, and Z and M in the middle, by which the network
    is odd. Pairs that are odd would keep it so by themselves, but for rounding.

    Args:
        start: the sets that learn first.
    """
    layers = five_layers(start)

    def feasible(p: FloatArray) -> FloatArray:
        return np.array(mirrored(as_sets(layers.feasible(p))))

    return LearningNetwork(layers.output, layers.gradient, feasible)


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
    """Return what a membership file holds of mode joint's sets, in numbers of six digits.

    Args:
        sets: the sets in `JOINT_SCALE`.
        change_limit: universe of the consequents [log variance].
    """
    ours = in_unit(sets, 1.0 / JOINT_SCALE)
    return FuzzyNetwork(FuzzySets(*map(_six_digits, ours)), 1.0, 1.0, change_limit)


def first_sets(network: FuzzyNetwork) -> FuzzySets:
    """Return the sets descent starts from, in scales of the training set.

    The file's numbers are taken as they are; what they count in, and the share of the whole error
    that a step goes, are the training set's to say. Steepest descent is blind in two places of
    the paper's initial sets, which are mended: a crisp D (slope 0) has no inverse and no
    derivative by its slope, and starts as the mirror image of I; a Z narrower than what D
    scatters when all is right fires nowhere, and starts as wide as that.
    """
    sets = network.sets
    mended = sets._replace(
        decrease_slope=sets.decrease_slope or -sets.increase_slope,
        zero_width=max(sets.zero_width, UNITS_PER_SCALE),
    )
    return in_unit(mended, UNITS_PER_SCALE)


def learned_network(
    sets: FuzzySets,
    position_scale: float,
    yaw_scale: float,
    change_scale: float,
    change_limit: float,
) -> FuzzyNetwork:
    """Return what a membership file holds of learned sets, in numbers of six digits.

    Args:
        sets: the sets in scales of the training set.
        position_scale: its scale of D in position rows [m^2].
        yaw_scale: its scale of D in yaw rows [rad^2].
        change_scale: its scale of dR [scales of D].
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
    """Return the same functions with arguments counted in a unit so many times as large."""
    return FuzzySets(
        *(
            value * unit if name.endswith("_slope") else value / unit
            for name, value in sets._asdict().items()
        )
    )


def _with_change_scaled(sets: FuzzySets, factor: float) -> FuzzySets:
    """Return sets whose output is so many times as large."""
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
