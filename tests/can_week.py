"""A week of the demo with the charger on CAN, told how full the car is and not. Fails where a morning is missed."""

import json
import subprocess
import sys

DAYS = 7


def main() -> int:
    """Run both; returns the exit status."""
    kept = True
    for soc in ("arrival", "never"):
        options = ("--plug", "can_elcon", "--days", str(DAYS), "--soc", soc, "--json")
        ended = subprocess.run(
            [sys.executable, "-m", "plugd", "demo", *options], check=True, stdout=subprocess.PIPE, text=True
        )
        told = json.loads(ended.stdout)
        nights = len(told.pop("nights"))
        sys.stdout.write(f"--soc {soc}: {nights} nights, {json.dumps(told)}\n")
        kept = kept and nights == DAYS and told["missed_mornings"] == 0
    return 0 if kept else 1


if __name__ == "__main__":
    sys.exit(main())
