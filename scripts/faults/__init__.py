"""The fault matrix: its rows, how they are run and recorded, what becomes of the recordings."""
