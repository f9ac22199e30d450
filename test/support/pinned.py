# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results of the filter that may not change: computed here, compared by test_pinned.py.

A change of how the core computes must not change what it computes, as long as each sensor is read
once a period, at its end. What the filters of the studies and the localizer gave is kept in
`pinned.npz`, and holds to 1e-9. Nothing of the core is called directly, so that its functions and
the layout of its arrays may change.

`pinned.npz` is written anew only when the method itself is changed on purpose, by

    python test/support/pinned.py

which names the cases that changed. The same code and the same libraries write the same bytes.
The simulated recordings are computed each time: if all cases of `study` change and none of `bag`,
the simulation has changed and not the filter.
"""

from pathlib import Path

import numpy as np
from pinned_bags import CASES_OF_BAGS, bag_results
from pinned_studies import STUDIES, UPPER, Records, study_results

from fnn_ekf_ros.core.arrays import FloatArray

FILE = Path(__file__).with_name("pinned.npz")
TOLERANCE = 1e-9
LEAD_DIGIT = 0.1
"""Diagnostics show the suspects' leads to one digit after the point [nats]."""
BITS = 40
"""Numbers are kept to so many, a part of 1e-12: the others fill the file and say nothing."""
CASES = (
    *(f"study/{name}/{each}" for name, case in STUDIES.items() for each in case.filters),
    *(f"bag/{name}" for name in CASES_OF_BAGS),
)


def compute(case: str) -> dict[str, Records]:
    """Return what a case gives now."""
    kind, *names = case.split("/")
    return study_results(*names) if kind == "study" else bag_results(*names)


def kept(case: str) -> dict[str, Records]:
    """Return what a case gave when the file was written; nothing if it was not there."""
    with np.load(FILE) as file:
        return {
            name.rpartition("/")[2]: file[name]
            for name in file.files
            if name.rpartition("/")[0] == case
        }


def differences(case: str, then: Records, now: Records) -> list[str]:
    """Return a sentence for each quantity that differs by more than it may."""
    if then.dtype != now.dtype or then.shape != now.shape:
        return [f"{case}: {now.shape} records of {now.dtype}, were {then.shape} of {then.dtype}"]
    found = []
    when, *quantities = then.dtype.names
    for quantity in (when, *quantities):
        one, other = then[quantity], now[quantity]
        same = one == other
        if one.dtype.kind == "f":
            close = np.abs(other - one) <= _allowed(quantity, then)
            same = same | close | (np.isnan(one) & np.isnan(other))
        if np.all(same):
            continue
        wrong = np.argwhere(~same)
        index = tuple(wrong[0].tolist())
        where = f"{when} {then[when][index[0]]}"
        inside = f" at {list(index[1:])}" if index[1:] else ""
        found.append(
            f"{case}: {quantity}{inside}, first at {where}, is {other[index].item()!r}, was "
            f"{one[index].item()!r}; {len(wrong)} of {one.size} values differ"
        )
    return found


def _allowed(quantity: str, then: Records) -> FloatArray:
    """Return by how much a quantity may differ, relative to its own scale where it has one."""
    value = np.abs(then[quantity])
    if quantity == "leads":
        return np.full_like(value, 1.01 * LEAD_DIGIT)
    if quantity == "covariance":
        std = np.sqrt(value[..., [0, 3, 5]])
        return TOLERANCE * std[..., UPPER[0]] * std[..., UPPER[1]]
    if quantity in ("process_noise", "measurement_noise"):
        return TOLERANCE * value
    if quantity == "mismatch":
        return TOLERANCE * (value + then["measurement_noise"])
    return TOLERANCE * (1.0 + value)


def _shortened(records: Records) -> Records:
    """Return records whose numbers have `BITS` bits."""
    short = records.copy()
    for quantity in records.dtype.names:
        if records[quantity].dtype == np.float64:
            mantissa, exponent = np.frexp(records[quantity])
            short[quantity] = np.ldexp(np.rint(np.ldexp(mantissa, BITS)), exponent - BITS)
    return short


def main() -> None:
    """Write the file anew and name what changed."""
    new: dict[str, Records] = {}
    for case in CASES:
        parts = compute(case)
        new |= {f"{case}/{part}": records for part, records in parts.items()}
        old = kept(case) if FILE.exists() else {}
        if not old:
            print(f"{case}: new")
            continue
        for part, records in parts.items():
            for line in differences(f"{case}/{part}", old[part], records):
                print(line)
    np.savez_compressed(FILE, **{name: _shortened(records) for name, records in new.items()})
    print(f"{FILE}: {len(CASES)} cases, {FILE.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
