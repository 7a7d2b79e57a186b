"""Compile the kernels ahead of the first run, in processes of their own."""
