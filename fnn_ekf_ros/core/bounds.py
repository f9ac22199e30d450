"""The limits of adapted noise."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class NoiseBounds:
    """What no adaptation can leave: variances, all more than 0.

    Attributes:
        process_min: smallest (Q forward, Q heading) (m^2, rad^2).
        process_max: largest.
        measurement_min: smallest R diagonal, rows as in `Row` (m^2, m^2, rad^2, rad^2).
        measurement_max: largest.
    """

    process_min: tuple[float, float]
    process_max: tuple[float, float]
    measurement_min: tuple[float, float, float, float]
    measurement_max: tuple[float, float, float, float]
