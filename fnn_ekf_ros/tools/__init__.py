"""The commands that work on files; each module has `add_arguments` and `run`."""
