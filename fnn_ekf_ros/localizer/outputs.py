# Copyright 2026 The fnn_ekf_ros developers
# SPDX-License-Identifier: Apache-2.0

"""The messages that the localizer publishes for a closed period."""

from collections.abc import Sequence

from fnn_ekf_ros.messages.names import DIAGNOSTICS
from fnn_ekf_ros.messages.writing import Message, diagnostics, estimate_messages
from fnn_ekf_ros.parameters.localizer import NODE_NAME, LocalizerParameters
from fnn_ekf_ros.timeline.events import Output, Status


def output_messages(
    output: Output,
    parameters: LocalizerParameters,
    name: str = NODE_NAME,
    more_statuses: Sequence[Status] = (),
) -> dict[str, Message]:
    """Return the messages of a closed period by topic.

    Args:
        output: of the period.
        parameters: the localizer's.
        name: of the node, for the diagnostics.
        more_statuses: of the publisher, beside the localizer's.
    """
    made: dict[str, Message] = {}
    if output.estimate is not None:
        made |= estimate_messages(output.estimate, parameters.frame_id, parameters.base_frame)
    if output.statuses is not None:
        made[DIAGNOSTICS] = diagnostics(output.stamp_ns, name, (*output.statuses, *more_statuses))
    return made
