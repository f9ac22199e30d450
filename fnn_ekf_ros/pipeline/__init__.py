"""From stamped events to estimates: the one place that orders events into periods and epochs."""
