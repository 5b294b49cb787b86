"""The program, `skyherd` and `python -m skyherd`: an interrupt is obeyed from its first moment on."""

import sys


def main() -> None:
    """Load the command line, which takes a second, and run it."""
    try:
        from skyherd.cli import main as run_command_line
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        sys.exit(130)
    run_command_line()


if __name__ == "__main__":
    main()
