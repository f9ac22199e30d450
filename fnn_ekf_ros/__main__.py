# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0
# PYTHON_ARGCOMPLETE_OK: the shell may ask for completions

"""`python3 -m fnn_ekf_ros NAME ...`."""

import sys

from fnn_ekf_ros.cli import main

sys.exit(main())
