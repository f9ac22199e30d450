"""Localization of two-wheeled robots by an EKF that finds its own noise."""
