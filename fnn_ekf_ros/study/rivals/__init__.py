"""Rival adaptive filters, each after its own paper and at the settings that suit it best.

Every module has `run(motion_model, recording, start, settings) -> Track` and a frozen dataclass
of settings whose defaults are the ones to compare with.
"""
