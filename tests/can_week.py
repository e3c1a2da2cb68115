"""A week of the demo with the charger on CAN. Fails where a morning is missed."""

import argparse
import json
import subprocess
import sys


def main() -> int:
    """Run it; returns the exit status."""
    parser = argparse.ArgumentParser(prog="can_week.py")
    parser.add_argument("--days", type=int, default=7)
    days = parser.parse_args().days
    options = ("--plug", "can_elcon", "--days", str(days), "--json")
    ended = subprocess.run(
        [sys.executable, "-m", "plugd", "demo", *options], check=True, stdout=subprocess.PIPE, text=True
    )
    told = json.loads(ended.stdout)
    nights = len(told.pop("nights"))
    sys.stdout.write(f"{nights} nights, {json.dumps(told)}\n")
    return 0 if nights == days and told["missed_mornings"] == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
