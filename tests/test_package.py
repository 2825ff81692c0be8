import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

import hmi_marl

ROOT = Path(__file__).parents[1]


def python(code):
    command = [sys.executable, "-c", code]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout


def test_importing_and_running_an_environment_imports_no_torch():
    pytest.importorskip("torch")  # otherwise the test would show nothing
    printed = python(
        "import sys, hmi_marl, gymnasium\n"
        "from hmi_marl import merge_v0\n"
        "env = merge_v0.env(duration=0.4, render_mode='rgb_array')\n"
        "env.reset(seed=0)\n"
        "for agent in env.agent_iter():\n"
        "    *_, terminated, truncated, _ = env.last()\n"
        "    env.step(None if terminated or truncated else 0)\n"
        "env.reset(); env.state(); env.render()\n"
        "gymnasium.make('hmi_marl/MergeHMI-v0', duration=0.4).reset(seed=0)\n"
        "import hmi_marl.cli\n"
        "print(sorted(m for m in sys.modules if m.split('.')[0] in ('torch', 'rsl_rl')))"
    )
    assert printed.strip().splitlines()[-1] == "[]"


def test_importing_the_package_imports_no_highway_env_and_opens_no_window():
    printed = python("import sys, hmi_marl; print('highway_env' in sys.modules)")
    assert printed.strip().splitlines()[-1] == "False"


@pytest.mark.parametrize("name", ["agents", "envs"])
def test_the_links_at_the_top_lead_into_the_package(name):
    link = ROOT / name
    assert link.is_symlink()
    assert str(link.readlink()) == f"hmi_marl/{name}"
    assert link.resolve() == (ROOT / "hmi_marl" / name).resolve()


def test_everything_that_is_promised_can_be_imported():
    from hmi_marl import DRIVERS, Driver, Scene, merge_v0

    assert list(DRIVERS) == ["lisa", "marge", "bart", "homer", "average"]
    assert isinstance(DRIVERS["bart"], Driver)
    assert Scene().vehicles == (1, 20)
    for make in ("env", "raw_env", "parallel_env"):
        assert callable(getattr(merge_v0, make))
    for name in hmi_marl.__all__:
        assert hasattr(hmi_marl, name)


def test_the_human_model_knows_no_road_and_no_agents():
    for module in ("attention", "alerts", "rewards", "drivers"):
        source = (ROOT / "hmi_marl" / "envs" / f"{module}.py").read_text()
        imported = set(re.findall(r"^(?:from|import) ([\w.]+)", source, re.MULTILINE))
        allowed = ("numpy", *(f"hmi_marl.envs.{own}" for own in ("alerts", "drivers", "streams")))
        ours = {name for name in imported if name.split(".")[0] not in sys.stdlib_module_names}
        assert all(name.startswith(allowed) for name in ours), (module, ours)


def test_arrows_point_one_way():
    order = ["envs", "agents", "training", "evaluation", "commands"]
    for place, folder in enumerate(order):
        for path in (ROOT / "hmi_marl" / folder).rglob("*.py"):
            for later in order[place + 1 :]:
                assert f"hmi_marl.{later}" not in _imports(path), (path, later)


def _imports(path):
    return "\n".join(re.findall(r"^\s*(?:from|import) .*", path.read_text(), re.MULTILINE))


def test_the_version_is_told_once_and_the_citation_agrees():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["dynamic"] == ["version"]
    assert project["license"] == "MIT"
    assert f"version: {hmi_marl.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {hmi_marl.__version__} " in (ROOT / "CHANGELOG.md").read_text()


def test_every_dependency_is_pinned():
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = list(pyproject["dependencies"])
    for extra in pyproject["optional-dependencies"].values():
        wanted += extra
    constraints = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = {line.split("==")[0].lower() for line in constraints if "==" in line}
    for requirement in wanted:
        name = re.match(r"[\w-]+", requirement).group().lower()
        assert name in pinned or name.replace("-", "_") in pinned, name


def test_files_keep_their_size():
    for path in (ROOT / "hmi_marl").rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 400, path
