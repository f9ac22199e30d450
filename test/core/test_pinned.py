# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""Results that may not change when the way to compute them does; see pinned.py."""

import pinned
import pytest


@pytest.mark.parametrize("case", pinned.CASES)
@pytest.mark.slow
def test_results_are_what_they_were(case: str) -> None:
    then, now = pinned.kept(case), pinned.compute(case)
    assert then.keys() == now.keys()
    found = [
        line
        for part, records in now.items()
        for line in pinned.differences(f"{case}/{part}", then[part], records)
    ]
    assert not found, "\n".join(found)
