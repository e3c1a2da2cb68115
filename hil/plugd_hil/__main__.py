"""`python -m plugd_hil bench SCENARIO…`, or `plugd_hil bench SCENARIO…`."""

import sys


def main() -> int:
    """One command so far; the stubs are modules of their own: `python -m plugd_hil.plug --help`."""
    match sys.argv[1:]:
        case ["bench", *rest]:
            from plugd_hil import bench  # noqa: PLC0415 # it draws, and that takes a second to import

            return bench.main(rest)
        case _:
            print("usage: plugd_hil bench SCENARIO…", file=sys.stderr)
            return 2


if __name__ == "__main__":
    sys.exit(main())
