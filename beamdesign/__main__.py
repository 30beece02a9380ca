"""`python -m beamdesign`, and where the command `beamdesign` begins."""

import sys


def main() -> None:
    """Run the command line; Ctrl-C while it is still being loaded is one line as well."""
    try:
        from beamdesign.cli import main as run
    except KeyboardInterrupt:
        print("beamdesign: interrupted", file=sys.stderr)
        sys.exit(130)
    run()


if __name__ == "__main__":
    main()
