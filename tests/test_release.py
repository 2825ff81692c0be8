"""The check before a release: what holds is said, and each thing left to do is found."""

import datetime
import subprocess
import zipfile

import pytest
import release
from pages import ROOT
from release import ToDoError


@pytest.fixture
def checkout(tmp_path):
    """A small project that can be released."""
    for name, text in {
        "hmi_marl/__init__.py": '__version__ = "1.2.3"\n',
        "CHANGELOG.md": "# Changelog\n\n## 1.2.3 (2026-01-02)\n\n## 1.2.2 (2025-01-02)\n",
        "CITATION.cff": "version: 1.2.3\ndate-released: 2026-01-02\n",
        "constraints.txt": "# pins\nnumpy==2.4.0\nhatchling==1.0\n",
        "pyproject.toml": '[build-system]\nrequires = ["hatchling==1.0"]\n'
        '[project]\ndependencies = ["NumPy>=2"]\n',
    }.items():
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_text(text)
    git(tmp_path, "init", "--quiet")
    commit(tmp_path)
    return tmp_path


def git(folder, *words):
    author = ["-c", "user.name=someone", "-c", "user.email=someone@example.org"]
    subprocess.run(["git", "-C", folder, *author, *words], check=True, capture_output=True)


def commit(folder):
    git(folder, "add", "--all")
    git(folder, "commit", "--quiet", "--message", "change")


OF_AGENTS = release.check_agents, release.check_comparison
CHECKS = [check for check in release.QUICK if check not in OF_AGENTS]


@pytest.mark.parametrize("check", CHECKS, ids=lambda check: check.__name__)
def test_a_project_that_can_be_released_passes(check, checkout):
    assert check(checkout)


TOMORROW = datetime.datetime.now(datetime.UTC).date() + datetime.timedelta(days=2)
WRONG = [
    (release.check_changelog, "CHANGELOG.md", "2026-01-02", "unreleased", "write the date"),
    (release.check_changelog, "CHANGELOG.md", "2026-01-02", str(TOMORROW), "in the future"),
    (release.check_changelog, "CHANGELOG.md", "## 1.2.3 ", "## 1.2.4 ", "begin with a section"),
    (release.check_citation, "CITATION.cff", "1.2.3", "1.2.2", "set version"),
    (release.check_citation, "CITATION.cff", "2026-01-02", "2026-01-03", "set date-released"),
    (release.check_pins, "constraints.txt", "numpy==2.4.0\n", "", "pin NumPy"),
    (release.check_pins, "constraints.txt", "2.4.0", "1.9", "is not NumPy>=2"),
    (release.check_clean, "constraints.txt", "pins", "pin", "commit or remove"),
    (release.check_tag, "hmi_marl/__init__.py", "1.2.3", "1.2", "MAJOR.MINOR.PATCH"),
]


@pytest.mark.parametrize(("check", "name", "old", "new", "words"), WRONG)
def test_what_is_left_to_do_is_said(check, name, old, new, words, checkout):
    path = checkout / name
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(ToDoError, match=words):
        check(checkout)
    assert next(release.results(checkout, (check,)))[0] is False


def test_the_tag_of_another_commit_is_found(checkout):
    git(checkout, "tag", "v1.2.3")
    assert "is this commit" in release.check_tag(checkout)
    (checkout / "more").write_text("more")
    commit(checkout)
    with pytest.raises(ToDoError, match=r"raise __version__"):
        release.check_tag(checkout)


def wheel_of(folder, *names, version="1.2.3"):
    wheel = folder.parent / "made.whl"
    with zipfile.ZipFile(wheel, "w") as files:
        files.writestr("p.dist-info/METADATA", f"Name: p\nVersion: {version}\n")
        for name in names:
            files.writestr(name, "")
    return wheel


def test_the_contents_of_the_wheel_are_checked(checkout):
    own, licence = "hmi_marl/__init__.py", "p.dist-info/licenses/LICENSE"
    assert "1 files" in release.check_contents(checkout, wheel_of(checkout, own, licence))
    for words, wheel in {
        "lacks hmi_marl": (licence,),
        "has tests/x.py": (own, licence, "tests/x.py"),
        "lacks LICENSE": (own,),
    }.items():
        with pytest.raises(ToDoError, match=words):
            release.check_contents(checkout, wheel_of(checkout, *wheel))
    with pytest.raises(ToDoError, match="of version 9"):
        release.check_contents(checkout, wheel_of(checkout, own, licence, version="9"))


def test_every_dependency_of_this_project_is_pinned_and_its_agents_are_whole():
    assert release.check_pins(ROOT)
    assert release.check_agents(ROOT)


def test_what_a_comparison_lacks_is_to_do(tmp_path):
    with pytest.raises(release.ToDoError, match=r"has no INDEX\.json .*; ship the comparison anew"):
        release.check_comparison(tmp_path)
