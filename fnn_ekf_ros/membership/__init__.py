"""Membership function files: packaged sets, and the reader of the users' own."""
