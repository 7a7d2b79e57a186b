"""Commands too long for `cli.py`, and what all commands share: options, progress, words."""
