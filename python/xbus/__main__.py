"""The command ``xbus``, which is also ``python -m xbus``."""

import sys

#: Exit status after Ctrl-C: 128 and the number of the signal.
INTERRUPTED = 130


def main() -> None:
    """Runs the command line. Ctrl-C ends it quietly even while its modules are imported."""
    try:
        from xbus.cli import main as run

        run()
    except KeyboardInterrupt:
        sys.exit(INTERRUPTED)


if __name__ == "__main__":
    main()
