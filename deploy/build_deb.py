"""The Debian package: an environment of its own in /opt/plugd from requirements.lock, for one suite and architecture.

Wheels are taken for the target, whatever this machine is, so nothing of the target has to run here. What the package
depends on is what Debian brings: the suite's Python, and the C and C++ libraries.
"""

import argparse
import gzip
import hashlib
import os
import re
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib.metadata import requires
from pathlib import Path
from textwrap import indent

from packaging.markers import Marker
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from deploy.manual import completion, man_page
from plugd import __version__
from plugd.cli import parser

ROOT = Path(__file__).resolve().parents[1]
EXTRAS = ("can", "web")
PIP = (sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", "--quiet")
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
NOT_NEEDED = {"joblib": "osqp's wheels are compiled already", "setuptools": "osqp's wheels are compiled already"}
"""Distributions that others ask for and plugd never imports, and why."""
LIBRARIES = ("libc6 (>= 2.28)", "libstdc++6", "zlib1g")
"""What the wheels load of Debian's."""
UNREAD = ("tests", "__pycache__", "*.pyi", "*.pyx", "*.pxd", "*.h", "*.a")
"""What is in wheels and read by nobody who runs them."""


@dataclass(frozen=True, slots=True)
class Target:
    """What the package is for."""

    suite: str
    python: str
    release: int
    glibc: int
    """The minor version of the suite's C library, which says what wheels may ask for."""

    def environment(self, machine: str) -> dict[str, str]:
        """As markers name it."""
        return {
            "python_version": self.python,
            "python_full_version": f"{self.python}.0",
            "platform_machine": machine,
            "platform_system": "Linux",
            "sys_platform": "linux",
            "os_name": "posix",
            "implementation_name": "cpython",
            "platform_python_implementation": "CPython",
        }

    def platforms(self, machine: str) -> list[str]:
        """Every kind of wheel that runs there, newest first."""
        return [f"manylinux_2_{minor}_{machine}" for minor in range(self.glibc, 16, -1)] + [f"manylinux2014_{machine}"]


TARGETS = {t.suite: t for t in (Target("bookworm", "3.11", 12, 36), Target("trixie", "3.13", 13, 41))}


def needed(environment: dict[str, str], extras: Iterable[str] = EXTRAS) -> set[str]:
    """The names of all that plugd with these extras stands on, by the metadata of what is installed here."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    lines = [*project["dependencies"], *(each for extra in extras for each in project["optional-dependencies"][extra])]
    asked = [Requirement(line) for line in lines]
    found: set[str] = set()
    seen: set[tuple[str, str]] = set()
    while asked:
        wish = asked.pop()
        name = canonicalize_name(wish.name)
        for extra in ("", *sorted(wish.extras)):
            if (name, extra) in seen or name in NOT_NEEDED:
                continue
            seen.add((name, extra))
            found.add(name)
            for line in requires(name) or ():
                inner = Requirement(line)
                if inner.marker is None or inner.marker.evaluate({**environment, "extra": extra}):
                    asked.append(inner)
    return found


def locked(lock: str, names: set[str], environment: dict[str, str]) -> Iterator[str]:
    """The lock's entries for these names and this target, hashes included, without their markers."""
    left = set(names)
    for entry in re.split(r"\n(?=\S)", lock.strip()):
        head, *hashes = entry.split(" \\\n")
        pin, _, marker = (part.strip() for part in head.partition(";"))
        name = canonicalize_name(pin.partition("==")[0])
        if name in names and (not marker or Marker(marker).evaluate(environment)):
            left.discard(name)
            yield " \\\n".join([pin, *hashes])
    if left:
        raise SystemExit(f"requirements.lock has no {', '.join(sorted(left))}; run make lock")


def run(*command: str | Path, cwd: Path = ROOT) -> None:
    """Run a program that must succeed."""
    subprocess.run([str(part) for part in command], check=True, cwd=cwd)


def wheels(site: Path, target: Target, machine: str, work: Path, extras: Iterable[str] = EXTRAS) -> list[str]:
    """Lay the locked wheels of all that is needed into `site`. Returns pip, told of the target."""
    environment = target.environment(machine)
    wanted = work / "wanted.txt"
    entries = locked((ROOT / "requirements.lock").read_text(encoding="utf-8"), needed(environment, extras), environment)
    wanted.write_text("\n".join(entries) + "\n", encoding="utf-8")
    platforms = [f"--platform={name}" for name in target.platforms(machine)]
    # What runs pip here need not be what the wheels are for.
    foreign = ["--ignore-requires-python", f"--python-version={target.python}", *platforms]
    install = [*PIP, "install", f"--target={site}", "--only-binary=:all:", "--no-deps", "--no-compile", *foreign]
    run(*install, "--require-hashes", f"--requirement={wanted}")
    return install


def install(site: Path, target: Target, machine: str, work: Path) -> None:
    """Lay all that is needed, and plugd, into `site`, and nothing that nobody reads."""
    pip = wheels(site, target, machine, work)
    source = work / "source"  # a build writes into its tree
    source.mkdir()
    for name in ("pyproject.toml", "README.md", "LICENSE"):
        shutil.copy2(ROOT / name, source)
    for name in ("plugd", "hil/plugd_hil", "etc"):
        shutil.copytree(ROOT / name, source / name, ignore=shutil.ignore_patterns("__pycache__"))
    run(*PIP, "wheel", "--no-deps", "--no-index", "--no-build-isolation", f"--wheel-dir={work}", ".", cwd=source)
    (wheel,) = work.glob("plugd-*.whl")
    run(*pip, "--no-index", wheel)
    for name in ("bin", "share", "plugd_hil"):  # scripts for this machine's Python, what /etc has, and the test bench
        shutil.rmtree(site / name, ignore_errors=True)
    for pattern in UNREAD:
        for path in [*site.rglob(pattern)]:
            shutil.rmtree(path) if path.is_dir() else path.unlink()


def lay_out(tree: Path, target: Target) -> None:
    """Everything but the environment's libraries, where Debian has it."""
    opt = tree / "opt/plugd"
    (opt / "bin").mkdir(parents=True)
    (opt / "bin/python3").symlink_to(f"/usr/bin/python{target.python}")
    (opt / "pyvenv.cfg").write_text("home = /usr/bin\ninclude-system-site-packages = false\n", encoding="utf-8")
    program = opt / "bin/plugd"
    program.write_text(
        "#!/opt/plugd/bin/python3 -sP\nimport sys\n\nfrom plugd.cli import main\n\nsys.exit(main())\n", encoding="utf-8"
    )
    program.chmod(0o755)
    (tree / "usr/bin").mkdir(parents=True)
    (tree / "usr/bin/plugd").symlink_to("/opt/plugd/bin/plugd")
    share, doc, units = (tree / "usr" / name for name in ("share/plugd", "share/doc/plugd", "lib/systemd/system"))
    for folder in (tree / "etc/plugd", share, doc, units):
        folder.mkdir(parents=True)
    shutil.copy(ROOT / "etc/plugd.toml", tree / "etc/plugd/plugd.toml")
    shutil.copytree(ROOT / "etc", share, dirs_exist_ok=True)
    shutil.copy(ROOT / "systemd/plugd-can.conf", share)
    shutil.copy(ROOT / "systemd/plugd.service", units)
    if target.release >= 13:
        (units / "plugd.service.d").mkdir()
        shutil.copy(ROOT / "systemd/plugd-backoff.conf", units / "plugd.service.d/backoff.conf")
    licence = (ROOT / "LICENSE").read_text(encoding="utf-8")
    (doc / "copyright").write_text(
        f"{licence}\nThe libraries in /opt/plugd have licences of their own, beside each of them: *.dist-info.\n",
        encoding="utf-8",
    )
    for path, text in (
        ("share/man/man1/plugd.1.gz", man_page(parser(), __version__)),
        ("share/doc/plugd/changelog.gz", f"plugd {__version__}\n"),
    ):
        (tree / "usr" / path).parent.mkdir(parents=True, exist_ok=True)
        (tree / "usr" / path).write_bytes(gzip.compress(text.encode(), mtime=0))
    completions = tree / "usr/share/bash-completion/completions"
    completions.mkdir(parents=True)
    (completions / "plugd").write_text(completion(parser()), encoding="utf-8")


def control(tree: Path, target: Target, architecture: str, version: str) -> None:
    """What dpkg is told."""
    files = [path for path in sorted(tree.rglob("*")) if path.is_file() and not path.is_symlink()]
    major, minor = target.python.split(".")
    folder = tree / "DEBIAN"
    fields = {
        "Package": "plugd",
        "Version": version,
        "Architecture": architecture,
        "Maintainer": "plugd contributors <plugd@localhost>",
        "Installed-Size": str(sum(-(-path.stat().st_size // 1024) for path in files)),
        "Depends": ", ".join((f"python3 (>= {target.python})", f"python3 (<< {major}.{int(minor) + 1})", *LIBRARIES)),
        "Recommends": "ca-certificates",
        "Suggests": "mosquitto",
        "Section": "net",
        "Priority": "optional",
        "Description": "charges an electric car when the grid is cleanest\n"
        + indent(
            "Looks at the coming nights together, switches a smart plug or charger over\n"
            "MQTT, and has the car ready every morning. Libraries it needs are in /opt/plugd.",
            " ",
        ),
    }
    folder.mkdir()
    sums = [f"{hashlib.md5(path.read_bytes()).hexdigest()}  {path.relative_to(tree)}\n" for path in files]
    (folder / "control").write_text("".join(f"{key}: {value}\n" for key, value in fields.items()), encoding="utf-8")
    (folder / "conffiles").write_text("/etc/plugd/plugd.toml\n", encoding="utf-8")
    (folder / "md5sums").write_text("".join(sums), encoding="utf-8")
    for name in ("postinst", "prerm", "postrm"):
        shutil.copy(ROOT / "deploy/deb" / name, folder)
        (folder / name).chmod(0o755)


def plain_modes(tree: Path) -> None:
    """As Debian has them, whatever the mask of who builds."""
    for path in (tree, *tree.rglob("*")):
        if not path.is_symlink():
            path.chmod(0o755 if path.is_dir() or path.stat().st_mode & 0o100 else 0o644)


def build(target: Target, architecture: str, revision: str, out: Path, quick: bool) -> Path:
    """The package's file, made anew."""
    version = f"{__version__}-{revision}~deb{target.release}"
    out.mkdir(parents=True, exist_ok=True)
    path = out / f"plugd_{version}_{architecture}.deb"
    with tempfile.TemporaryDirectory() as folder:
        work, tree = Path(folder), Path(folder, "tree")
        lay_out(tree, target)
        site = tree / f"opt/plugd/lib/python{target.python}/site-packages"
        install(site, target, MACHINES[architecture], work)
        control(tree, target, architecture, version)
        plain_modes(tree)
        how = ["-Zgzip", "-z1"] if quick else ["-Zxz"]
        run("dpkg-deb", "--root-owner-group", *how, "--build", tree, path.resolve())
    return path


def _said(*command: str) -> str:
    return subprocess.run(command, check=True, capture_output=True, text=True, cwd=ROOT).stdout.strip()


def _committed_s() -> str:
    """When the source last changed, Unix seconds: its last commit, or its project file where there is no history."""
    ran = subprocess.run(["git", "log", "-1", "--format=%ct"], check=False, capture_output=True, text=True, cwd=ROOT)
    return ran.stdout.strip() or str(int((ROOT / "pyproject.toml").stat().st_mtime))


def here() -> str:
    """This machine's architecture, as Debian calls it."""
    return _said("dpkg", "--print-architecture")


def main() -> int:
    """Build it. Returns the exit code."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--suite", choices=TARGETS, default="bookworm")
    options.add_argument("--arch", choices=MACHINES, help="default: this machine's")
    options.add_argument("--revision", default="1", help="of the package, for the same plugd (default 1)")
    options.add_argument("--out", type=Path, default=ROOT / "dist")
    options.add_argument("--quick", action="store_true", help="packed fast instead of small, for tests")
    given = options.parse_args()
    os.environ.setdefault(
        "SOURCE_DATE_EPOCH", _said("git", "log", "-1", "--format=%ct")
    )  # the same files, the same bytes
    path = build(TARGETS[given.suite], given.arch or here(), given.revision, given.out, given.quick)
    print(f"{path}: {path.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
