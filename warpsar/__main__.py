"""`python -m warpsar` is `warpsar`."""

from warpsar.cli.main import main

if __name__ == "__main__":
    main(prog_name="warpsar")
