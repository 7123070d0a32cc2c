"""Runs the command line as ``python -m hexservo``."""

from hexservo.cli import main

if __name__ == "__main__":
    main()
