"""`python -m ovmot`: the command line."""

from ovmot.cli import main

if __name__ == "__main__":
    main()
