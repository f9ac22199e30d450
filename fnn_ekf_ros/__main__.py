"""`python3 -m fnn_ekf_ros NAME ...`."""

import sys

from fnn_ekf_ros.cli import main

sys.exit(main())
