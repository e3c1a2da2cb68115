"""A fresh Debian, booted: debootstrap's root under systemd-nspawn, with a network of its own that is only loopback.

Everything written while it runs is gone with it; the root itself is made once and kept in the cache.
"""

import os
import re
import shlex
import shutil
import subprocess
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

CACHE = Path(os.environ.get("PLUGD_CACHE") or Path.home() / ".cache/plugd")
MIRROR = "http://deb.debian.org/debian"
PACKAGES = ("systemd", "systemd-sysv", "dbus", "python3", "mosquitto", "mosquitto-clients")
"""What stands for a Debian that is in use: an init system, Python, and the broker that plugd needs."""
PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
BOOT_S, HALT_S = 90.0, 20.0


class Failed(Exception):
    """Something did not go as it must."""


def require(*programs: str) -> None:
    """Raises Failed where something to work with is missing."""
    if missing := [name for name in programs if shutil.which(name) is None]:
        raise Failed(f"missing: {' '.join(missing)}; sudo apt install debootstrap systemd-container dpkg")
    if os.geteuid() != 0:
        raise Failed("only root can make and boot a Debian root; sudo it")


def root(suite: str, architecture: str) -> Path:
    """The suite's root, made now where the cache has none. Another architecture has to be `runnable`."""
    path = CACHE / f"{suite}-{architecture}-root"
    if not path.exists():
        print(f"making {path} (minutes, once)", flush=True)
        CACHE.mkdir(parents=True, exist_ok=True)
        unfinished = path.with_suffix(".unfinished")
        shutil.rmtree(unfinished, ignore_errors=True)
        options = ["--variant=minbase", f"--arch={architecture}", f"--include={','.join(PACKAGES)}"]
        subprocess.run(["debootstrap", *options, suite, unfinished, MIRROR], check=True, stdout=subprocess.DEVNULL)
        # What an installer writes and debootstrap does not.
        (unfinished / "etc/hosts").write_text("127.0.0.1 localhost\n::1 localhost\n127.0.1.1 fresh\n", encoding="utf-8")
        unfinished.rename(path)
    return path


@contextmanager
def runnable(qemu: str) -> Iterator[None]:
    """Programs of another machine run here, through qemu's emulator for it; as before at the end."""
    names = Path("/proc/sys/fs/binfmt_misc")
    mounted = names.joinpath("status").exists()
    if not mounted:
        subprocess.run(["mount", "-t", "binfmt_misc", "binfmt_misc", str(names)], check=True)
    known = names / qemu
    registered = known.exists()
    if not registered:
        lines = Path(f"/usr/lib/binfmt.d/{qemu}.conf").read_text(encoding="ascii").splitlines()
        (names / "register").write_text(next(x for x in lines if x.startswith(":")), encoding="ascii")
    try:
        yield
    finally:
        if not registered:
            known.write_text("-1", encoding="ascii")
        if not mounted:
            subprocess.run(["umount", str(names)], check=True)


def inside(tree: Path, *options: str) -> list[str]:
    """How a program is run in a root: with a network that is only loopback, and nothing it writes is kept."""
    command = ["systemd-nspawn", "--quiet", f"--directory={tree}", "--volatile=overlay", "--private-network"]
    return [*command, "--register=no", "--keep-unit", "--console=pipe", "--machine=fresh", *options]


@dataclass(frozen=True, slots=True)
class Machine:
    """A booted root."""

    leader: int
    """The process of its init, as seen from here."""

    def run(self, command: str | Sequence[str], timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
        """What a command in it says and how it ends. A text goes through its shell."""
        words = ["sh", "-c", command] if isinstance(command, str) else command
        entered = ["nsenter", "-t", str(self.leader), "-a", "env", "-i", f"PATH={PATH}", *words]
        return subprocess.run(
            entered, check=False, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=timeout_s
        )

    def do(self, command: str | Sequence[str], timeout_s: float = 120.0) -> str:
        """What a command in it says. Raises Failed unless it ends with 0."""
        ran = self.run(command, timeout_s)
        if ran.returncode:
            words = command if isinstance(command, str) else shlex.join(command)
            raise Failed(f"{words}: exit {ran.returncode}\n{ran.stdout}{ran.stderr}")
        return ran.stdout.strip()

    def until(self, command: str, timeout_s: float) -> float:
        """Seconds until a command succeeds. Raises Failed after too many."""
        began_s = time.monotonic()
        while self.run(command).returncode:
            if time.monotonic() - began_s > timeout_s:
                raise Failed(f"not within {timeout_s:.0f} s: {command}")
            time.sleep(0.2)
        return time.monotonic() - began_s


@contextmanager
def booted(suite: str, architecture: str, packages: Path) -> Iterator[Machine]:
    """The suite's root, running, with `packages` to be read at /packages. Halted at the end, whatever happens."""
    command = inside(root(suite, architecture), "--boot", f"--bind-ro={packages}:/packages")
    quiet = subprocess.DEVNULL
    nspawn = subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    try:
        machine = Machine(_leader(nspawn))
        machine.until("test -S /run/systemd/private && systemctl is-system-running --wait", BOOT_S)
        yield machine
    finally:
        nspawn.terminate()  # to nspawn that is "power off"
        try:
            nspawn.wait(HALT_S)
        except subprocess.TimeoutExpired:
            nspawn.kill()
            nspawn.wait()


def _leader(nspawn: "subprocess.Popen[bytes]") -> int:
    """The init of the root: at first nspawn has another child, which only makes that one and ends."""
    children = Path(f"/proc/{nspawn.pid}/task/{nspawn.pid}/children")
    for _ in range(100):
        if nspawn.poll() is not None:
            raise Failed(f"systemd-nspawn ended with {nspawn.returncode}; try it by hand: it says why")
        for child in children.read_text(encoding="ascii").split():
            with suppress(OSError):  # it has ended meanwhile
                if re.search(r"^NSpid:.*\t1$", Path(f"/proc/{child}/status").read_text(encoding="utf-8"), re.MULTILINE):
                    return int(child)
        time.sleep(0.1)
    raise Failed("systemd-nspawn starts nothing")


def say(what: str) -> None:
    """A line of the report."""
    print(f"ok  {what}", flush=True)
