"""The benchmark of `make bench`: one module for each group of rows, with its worker processes."""
