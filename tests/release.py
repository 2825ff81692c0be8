"""Check that this commit can be released: ``make release-check``, or ``python tests/release.py``.

Each step of RELEASING.md that a program can check is a line here: what holds, or what to do. The
exit status is 1 if anything is to do. ``--quick`` builds neither the site nor the wheel.
"""

from __future__ import annotations

import argparse
import datetime
import re
import subprocess
import sys
import tempfile
import tomllib
import zipfile
from collections.abc import Callable, Iterator
from email import message_from_bytes
from pathlib import Path

import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
LARGEST_WHEEL = 60
"""Megabytes, below what package indices take."""


class ToDoError(Exception):
    """What has to be done before a release."""


def version(root: Path) -> str:
    """The version of the package, as its sources say."""
    found = re.search(r'^__version__ = "(.+)"$', _read(root / "hmi_marl/__init__.py"), re.MULTILINE)
    if not found or not re.fullmatch(r"\d+\.\d+\.\d+", found[1]):
        raise ToDoError("set __version__ in hmi_marl/__init__.py to MAJOR.MINOR.PATCH")
    return found[1]


def check_changelog(root: Path) -> str:
    """The newest section of the changelog is that of the version, with its date."""
    newest = re.search(r"^## (\S+) \((.+)\)$", _read(root / "CHANGELOG.md"), re.MULTILINE)
    wanted = version(root)
    if not newest or newest[1] != wanted:
        raise ToDoError(f"CHANGELOG.md: begin with a section '## {wanted} (YYYY-MM-DD)'")
    try:
        date = datetime.date.fromisoformat(newest[2])
    except ValueError:
        raise ToDoError(f"CHANGELOG.md: write the date in place of ({newest[2]})") from None
    if date > datetime.datetime.now(datetime.UTC).date():
        raise ToDoError(f"CHANGELOG.md: {date} is in the future")
    return f"CHANGELOG.md has {wanted} of {date}"


def check_citation(root: Path) -> str:
    """CITATION.cff names the version, the day of the changelog, and the paper."""
    citation, wanted = yaml.safe_load(_read(root / "CITATION.cff")), version(root)
    if str(citation.get("version")) != wanted:
        raise ToDoError(f"CITATION.cff: set version: {wanted}")
    newest = re.search(r"^## \S+ \((.+)\)$", _read(root / "CHANGELOG.md"), re.MULTILINE)
    if newest is None or str(citation.get("date-released")) != newest[1]:
        raise ToDoError("CITATION.cff: set date-released to the date in CHANGELOG.md")
    return "CITATION.cff has the version and its date"


def check_pins(root: Path) -> str:
    """Every dependency is pinned in constraints.txt, at a version that its range allows."""
    project = tomllib.loads(_read(root / "pyproject.toml"))
    optional = project["project"].get("optional-dependencies", {}).values()
    wanted = [*project["project"]["dependencies"], *project["build-system"]["requires"]]
    wanted += [text for extra in optional for text in extra]
    pins = dict(
        line.split("==")
        for line in _read(root / "constraints.txt").splitlines()
        if line and not line.startswith("#")
    )
    versions = {canonicalize_name(name): pinned for name, pinned in pins.items()}
    for requirement in map(Requirement, wanted):
        pinned = versions.get(canonicalize_name(requirement.name))
        if pinned is None:
            raise ToDoError(f"constraints.txt: pin {requirement.name}")
        if not requirement.specifier.contains(pinned):
            raise ToDoError(f"constraints.txt: {requirement.name}=={pinned} is not {requirement}")
    return f"constraints.txt pins all {len(wanted)} dependencies"


def check_clean(root: Path) -> str:
    """Nothing is changed or unknown in the checkout."""
    if changed := _git(root, "status", "--porcelain"):
        raise ToDoError(
            f"commit or remove what git status shows ({len(changed.splitlines())} files)"
        )
    return "the checkout is clean"


def check_tag(root: Path) -> str:
    """The tag of the version is on this commit, or still to be made."""
    tag = f"v{version(root)}"
    if not _git(root, "tag", "--list", tag):
        return f"after this: git tag -a {tag}"
    if _git(root, "rev-parse", f"{tag}^{{commit}}") != _git(root, "rev-parse", "HEAD"):
        raise ToDoError(f"{tag} is another commit: raise __version__")
    return f"{tag} is this commit"


def check_agents(root: Path) -> str:
    """The shipped agents have the checksums of their index."""
    from hmi_marl.agents.learned.cards import shipped_agents

    try:
        return f"{len(shipped_agents(root / 'hmi_marl' / 'trained'))} shipped agents are whole"
    except (OSError, ValueError) as error:
        raise ToDoError(f"ship the agents anew (hmi-marl reproduce ship): {error}") from None


def check_comparison(root: Path) -> str:
    """The shipped comparison is whole, and the shipped pairs are those that it shows."""
    from hmi_marl.reproduction.comparison import check_shipped

    try:
        pairs = check_shipped(root / "docs" / "compare", root / "hmi_marl" / "trained")
    except (OSError, ValueError) as error:
        raise ToDoError(str(error)) from None
    return f"the shipped comparison is whole, and shows {len(pairs)} of the shipped agents"


def check_site(root: Path) -> str:
    """The site builds without a warning."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, root / "docs" / "making", "--site-dir", f"{folder}/site"]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            raise ToDoError("make docs: mend what it prints")
    return "the site builds"


def check_wheel(root: Path) -> str:
    """A wheel builds, and holds the package, its agents and licence, and nothing else."""
    with tempfile.TemporaryDirectory() as folder:
        pins = root / "constraints.txt"
        command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--quiet", "-c", pins]
        run = subprocess.run(
            [*command, "--wheel-dir", folder, root], capture_output=True, text=True, check=False
        )
        wheels = list(Path(folder).glob("*.whl"))
        if run.returncode or len(wheels) != 1:
            raise ToDoError(f"pip wheel fails: {run.stderr.strip().splitlines()[-1:]}")
        return check_contents(root, wheels[0])


def check_contents(root: Path, wheel: Path) -> str:
    """A wheel holds the tracked files of the package, its licence, and nothing else."""
    tracked = set(_git(root, "ls-files", "hmi_marl").splitlines())
    with zipfile.ZipFile(wheel) as files:
        names = [name for name in files.namelist() if not name.endswith("/")]
        (place,) = [name for name in names if name.endswith(".dist-info/METADATA")]
        metadata = message_from_bytes(files.read(place))
    if metadata["Version"] != version(root):
        raise ToDoError(f"the wheel is of version {metadata['Version']}, not {version(root)}")
    own = {name for name in names if ".dist-info/" not in name}
    for name in sorted(own ^ tracked):
        raise ToDoError(f"the wheel {'has' if name in own else 'lacks'} {name}")
    if not any(name.endswith("/licenses/LICENSE") for name in names):
        raise ToDoError("the wheel lacks LICENSE")
    if (size := wheel.stat().st_size / 1e6) > LARGEST_WHEEL:
        raise ToDoError(f"the wheel has {size:.0f} MB, more than {LARGEST_WHEEL}")
    return f"the wheel holds {len(own)} files in {size:.0f} MB"


QUICK: tuple[Callable[[Path], str], ...] = (
    check_changelog,
    check_citation,
    check_pins,
    check_clean,
    check_tag,
    check_agents,
    check_comparison,
)
SLOW = (check_site, check_wheel)


def results(root: Path, checks: tuple[Callable[[Path], str], ...]) -> Iterator[tuple[bool, str]]:
    """Whether each check holds, and its line."""
    for check in checks:
        try:
            yield True, check(root)
        except ToDoError as todo:
            yield False, str(todo)


def _read(path: Path) -> str:
    return path.read_text("utf-8")


def _git(root: Path, *words: str) -> str:
    run = subprocess.run(["git", "-C", root, *words], capture_output=True, text=True, check=True)
    return run.stdout.strip()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description="Check that this commit can be released.")
    parser.add_argument("--quick", action="store_true", help="build neither site nor wheel")
    chosen = QUICK if parser.parse_args().quick else QUICK + SLOW
    whole = True
    for holds, line in results(ROOT, chosen):
        whole &= holds
        print(f"{'ok   ' if holds else 'TO DO'}  {line}", flush=True)
    sys.exit(not whole)
