"""Every parameter of every executable: its default, its limits, its sentence. Each lives once."""
