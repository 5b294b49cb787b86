"""Entry point of `skyherd` and `python -m skyherd`."""

import sys


def main() -> None:
    """Load and run the command line; honour an interrupt while it is still loading.

    Exits with the command's code (`skyherd.cli` lists them), or with 130 after an interrupt.
    """
    try:
        from skyherd.cli import main as run_command_line
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    run_command_line()


if __name__ == "__main__":
    main()
