"""The package in a fresh Debian: install, configure, start, freeze, upgrade, remove, purge. Needs root."""

import argparse
import json
import os
import re
import shutil
import sys
import tempfile
import time
from pathlib import Path

from deploy.build_deb import ROOT, TARGETS, Target, build, here, run
from deploy.machine import CACHE, Failed, Machine, booted, require, say

ACTIVE_S = 5.0
"""How long a start may take, with a broker there."""
FROZEN_S = 200.0
"""How long until a frozen daemon runs again: WatchdogSec, then the restart; twice that on a busy machine."""
PASSWORD = "a word that nobody else says"
BROKER = "listener 1883 127.0.0.1\nallow_anonymous false\npassword_file /etc/mosquitto/passwd\n"
PROBLEM = {
    "slot_h": 0.5,
    "power_max_kw": 2.3,
    "capacity_kwh": 50.0,
    "efficiency": 0.9,
    "soc_pct": 40.0,
    "soc_min_pct": 20.0,
    "soc_max_pct": 80.0,
    "sessions": [{"intensity": [200, 150, 100, 120, 90] * 4, "morning_minimum_pct": 45.0, "daily_use_kwh": 8.0}] * 4,
    "end_value_g_per_kwh": 50.0,
}
UNSEEN = (
    *("/proc", "/sys", "/dev", "/run", "/tmp", "/packages"),
    *("/var/log", "/var/lib/dpkg", "/var/lib/apt", "/var/cache/debconf"),
)
"""Where a purge may leave traces: the system's own books. apt 3 makes a folder below debconf."""


def newer(package: Path, folder: Path) -> Path:
    """The same package under the next revision, for an upgrade."""
    tree = folder / "newer"
    run("dpkg-deb", "--raw-extract", package, tree)
    control = tree / "DEBIAN/control"
    control.write_text(
        re.sub(r"(?m)^(Version: .*)-1~", r"\1-2~", control.read_text(encoding="utf-8")), encoding="utf-8"
    )
    path = folder / "newer.deb"
    run("dpkg-deb", "--root-owner-group", "-Zgzip", "-z1", "--build", tree, path)
    shutil.rmtree(tree)
    return path


def shown(machine: Machine, name: str) -> str:
    """A property of the service."""
    return machine.do(["systemctl", "show", "--value", f"--property={name}", "plugd"])


def start(machine: Machine) -> float:
    """Seconds until systemd calls it active. Raises Failed when it does not."""
    began_s = time.monotonic()
    machine.do("systemctl start plugd || { journalctl -u plugd --no-pager >&2; exit 1; }", 200.0)
    return time.monotonic() - began_s


def heard(machine: Machine, topic: str, login: str = "") -> str:
    """What the broker keeps, or next hears, under a topic."""
    return machine.do(f"mosquitto_sub -h localhost {login} -t {topic} -C 1 -W 30", 40.0)


def files(machine: Machine) -> set[str]:
    """Every path that is not the system's own book-keeping."""
    pruned = " -o ".join(f"-path {path}" for path in UNSEEN)
    return set(machine.do(f"find / \\( {pruned} \\) -prune -o -print").splitlines())


def expect(good: bool, what: str) -> None:
    """Say what holds. Raises Failed where it does not."""
    if not good:
        raise Failed(what)
    say(what)


def installed(machine: Machine) -> None:
    """Installed, not yet started, and every way to it works."""
    began_s = time.monotonic()
    machine.do("apt-get install -y --no-install-recommends /packages/plugd.deb", 600.0)
    size_mb = int(machine.do("du -sk /opt/plugd").split()[0]) / 1000
    say(f"installed in {time.monotonic() - began_s:.0f} s; /opt/plugd has {size_mb:.0f} MB, compiled code included")
    expect(shown(machine, "ActiveState") == "inactive", "nothing is switched before it is configured")
    expect(machine.do("plugd --version").startswith("plugd "), "the command is found")
    checked = machine.run("plugd check").stdout
    expect("ok    broker" in checked, "plugd check finds the broker")


def started(machine: Machine) -> None:
    """Two lines of configuration, and it runs, within its walls."""
    plug = "/opt/plugd/bin/python3 -m plugd_hil.plug --topic garage"
    machine.do(f"systemd-run --quiet --unit=garage -p WorkingDirectory=/packages -p Environment=PYTHONPATH=. {plug}")
    machine.until("mosquitto_sub -h localhost -t tele/garage/LWT -C 1 -W 5 | grep -q Online", 60.0)
    edit = 's/^topic = "ev-plug"/topic = "garage"/; s/^capacity_kwh = 50/capacity_kwh = 40/'
    machine.do(["sed", "-i", edit, "/etc/plugd/plugd.toml"])
    took_s = start(machine)
    process = shown(machine, "MainPID")
    ticks = machine.do(f"cat /proc/{process}/stat").rpartition(")")[2].split()
    busy_s = (int(ticks[11]) + int(ticks[12])) / os.sysconf("SC_CLK_TCK")
    what = f"active {took_s:.1f} s after the start (at most {ACTIVE_S:.0f}), of it {busy_s:.1f} s on the processor"
    expect(took_s <= ACTIVE_S, what)
    expect(heard(machine, "plugd/ev/availability") == "online", "online at the broker")
    expect(shown(machine, "StatusText") == json.loads(heard(machine, "plugd/ev/state"))["reason"], "the status is why")
    status = machine.do(f"cat /proc/{process}/status")
    confined = ("Seccomp:\t2", "NoNewPrivs:\t1", "CapEff:\t0000000000000000")
    expect(all(word in status for word in confined) and "Uid:\t0" not in status, "confined, and not root")
    page = "import urllib.request as u; print(u.urlopen('http://127.0.0.1:8480/', timeout=9).status)"
    expect(machine.do(["/opt/plugd/bin/python3", "-c", page]) == "200", "the page answers")
    peak_mb = int(re.search(r"VmHWM:\s+(\d+)", status)[1]) / 1000  # type: ignore[index]
    say(f"resident at the most so far: {peak_mb:.0f} MB")


def planned(machine: Machine) -> None:
    """Once told how full the car is, the daemon plans; nothing is amiss but the forecast, which cannot be had here."""
    machine.do("mosquitto_pub -h localhost -q 1 -t plugd/ev/soc/set -m 60")
    machine.until("mosquitto_sub -h localhost -t plugd/ev/state -C 1 -W 5 | grep -q '\"soc_pct\": *60'", 30.0)
    expect(len(json.loads(heard(machine, "plugd/ev/plan"))) > 0, "told how full the car is, it plans")
    log = machine.do("journalctl -u plugd -p warning -o cat --no-pager").splitlines()
    amiss = [line for line in log if not line.startswith("forecast: ")]
    expect(not amiss, f"its log has no complaint but that there is no forecast{''.join(amiss[:3])}")


def solved(machine: Machine, unit: str) -> None:
    """OSQP plans inside the unit's walls, native code, arrays and all."""
    walls = [line for line in unit.splitlines() if re.match("(System|Memory|Restrict|Protect|Private|Lock)", line)]
    given = " ".join(f"-p '{line}'" for line in walls)
    machine.do(f"cat > /etc/problem.json <<'END'\n{json.dumps(PROBLEM)}\nEND")
    answer = machine.do(
        f"systemd-run --quiet --wait --pipe -p DynamicUser=yes {given} plugd plan --json --problem /etc/problem.json"
    )
    machine.do("rm /etc/problem.json")
    expect(json.loads(answer)["solver"] == "osqp", f"OSQP plans within {len(walls)} of the unit's walls")


def frozen(machine: Machine) -> None:
    """Stopped in its tracks, it is killed and started again, and tells where it hung."""
    process = shown(machine, "MainPID")
    machine.do(f"kill -STOP {process}")
    took_s = machine.until(
        f"test $(systemctl show --value -p MainPID plugd) != {process} && systemctl is-active plugd", FROZEN_S
    )
    expect(shown(machine, "NRestarts") == "1", f"frozen, it runs again after {took_s:.0f} s")
    log = machine.do("journalctl -u plugd --no-pager")
    expect("Watchdog timeout" in log and "Fatal Python error: Aborted" in log, "the log says where it hung")


def secret(machine: Machine) -> None:
    """A password that only root can read is handed over, and seen nowhere."""
    for line in (
        f"mosquitto_passwd -b -c /etc/mosquitto/passwd plugd '{PASSWORD}'",
        "chown mosquitto: /etc/mosquitto/passwd",
        f"printf '{BROKER}' > /etc/mosquitto/conf.d/passwords.conf",
        "systemctl restart mosquitto",
        "sed -i 's/^# username = /username = /; s/^# password_file = /password_file = /' /etc/plugd/plugd.toml",
        f"(umask 077; printf '%s\\n' '{PASSWORD}' > /etc/plugd/mqtt_password)",
        "systemctl restart plugd",
    ):
        machine.do(line)
    login = f"-u plugd -P '{PASSWORD}'"
    expect(heard(machine, "plugd/ev/availability", login) == "online", "online with the password")
    process = shown(machine, "MainPID")
    expect(machine.do("stat -c %a:%U /etc/plugd/mqtt_password") == "600:root", "which only root can read")
    seen = machine.run(
        f"journalctl --no-pager | cat - /proc/{process}/cmdline /proc/{process}/environ | grep -F '{PASSWORD}'"
    )
    expect(seen.returncode == 1, "and which is in no log, argument or variable")
    expect("ok    broker" in machine.run("plugd check").stdout, "root's plugd check takes the same file")


def upgraded(machine: Machine) -> None:
    """A newer package: restarted, configuration and state as they were."""
    login = f"-u plugd -P '{PASSWORD}'"
    machine.do(f"mosquitto_pub -h localhost {login} -q 1 -t plugd/ev/minimum/set -m 63")
    kept = f"mosquitto_sub -h localhost {login} -t plugd/ev/state -C 1 -W 5 | grep -q '\"minimum_pct\": *63'"
    machine.until(kept, 30.0)
    machine.do("plugd history show")
    foreign = machine.do("find /var/lib/private/plugd -user root")
    expect(not foreign, "root reads the running service's state and leaves nothing of root's there")
    process = shown(machine, "MainPID")
    machine.do("apt-get install -y --no-install-recommends /packages/newer.deb", 600.0)
    expect(shown(machine, "MainPID") not in ("0", process), "upgraded, it was restarted")
    machine.until(kept, 30.0)
    say("the minimum that was set is kept")
    expect("capacity_kwh = 40" in machine.do("cat /etc/plugd/plugd.toml"), "the edited configuration is kept")


def misconfigured(machine: Machine) -> None:
    """A wrong configuration is said and not tried again and again."""
    machine.do("cp /etc/plugd/plugd.toml /tmp/good.toml; echo 'nonsense = 1' >> /etc/plugd/plugd.toml")
    machine.run("systemctl restart plugd")
    time.sleep(8.0)  # longer than RestartSec
    told = [shown(machine, name) for name in ("ActiveState", "ExecMainStatus", "NRestarts")]
    expect(told == ["failed", "78", "0"], "a wrong configuration ends it, once")
    machine.do("cp /tmp/good.toml /etc/plugd/plugd.toml; systemctl reset-failed plugd")


def removed(machine: Machine, before: set[str]) -> None:
    """Remove keeps what is the user's, purge nothing."""
    machine.do("systemctl stop garage; systemctl enable --now plugd; apt-get remove -y plugd", 300.0)
    expect(machine.run("systemctl is-active plugd").returncode != 0, "removed, it does not run")
    kept = ("/etc/plugd/plugd.toml", "/etc/plugd/mqtt_password", "/var/lib/private/plugd/plugd.db")
    expect(not machine.run(["ls", *kept]).returncode, "configuration, secret and state are kept")
    expect(machine.run("ls /opt/plugd").returncode != 0, "nothing else is")
    machine.do("dpkg --purge plugd", 300.0)
    mine = {"/etc/mosquitto/passwd", "/etc/mosquitto/conf.d/passwords.conf"}
    left = sorted(files(machine) - before - mine)
    left = [path for path in left if not path.startswith(("/var/lib/mosquitto", "/var/lib/systemd", "/var/cache/apt"))]
    expect(not left, f"purged, nothing is left{': ' + ' '.join(left[:9]) if left else ''}")


def scenario(target: Target, package: Path) -> None:
    """All of it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shutil.copy(package, folder / "plugd.deb")
        shutil.copytree(ROOT / "hil/plugd_hil", folder / "plugd_hil")
        newer(package, folder)
        with booted(target.suite, here(), folder) as machine:
            before = files(machine)
            installed(machine)
            started(machine)
            planned(machine)
            solved(machine, machine.do("cat /usr/lib/systemd/system/plugd.service"))
            frozen(machine)
            secret(machine)
            upgraded(machine)
            misconfigured(machine)
            removed(machine, before)


def main() -> int:
    """Try it. Returns the exit code."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--suite", choices=TARGETS, default="bookworm")
    options.add_argument("--package", type=Path, metavar="DEB", help="default: one built now")
    given = options.parse_args()
    began_s = time.monotonic()
    try:
        require("debootstrap", "systemd-nspawn", "dpkg-deb")
        target = TARGETS[given.suite]
        package = given.package or build(target, here(), "1", CACHE / "dist", quick=True)
        scenario(target, package)
    except Failed as failure:
        print(f"FAILED  {failure}", file=sys.stderr)
        return 1
    print(f"{given.suite}: all of it in {time.monotonic() - began_s:.0f} s")
    return 0


if __name__ == "__main__":
    sys.exit(main())
