import ast
import fnmatch
import functools
import graphlib
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


@pytest.mark.usefixtures("unmeasured")
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


def test_importing_the_package_imports_none_of_its_modules():
    printed = python(
        "import sys, hmi_marl\n"
        "print(sorted(m for m in sys.modules if m.startswith('hmi_marl.')))\n"
        "print(hmi_marl.Driver is hmi_marl.DRIVERS['homer'].__class__, 'Scene' in dir(hmi_marl))"
    )
    assert printed.split("\n")[:2] == ["['hmi_marl.interrupts']", "True True"]


def test_a_name_that_is_not_public_is_no_attribute():
    with pytest.raises(AttributeError, match="module 'hmi_marl' has no attribute 'drivr'"):
        hmi_marl.drivr  # noqa: B018


def test_every_public_name_is_imported_from_its_home():
    assert set(hmi_marl._HOMES) == set(hmi_marl.__all__) - {"__version__"}
    assert hmi_marl.merge_v0.__name__ == "hmi_marl.envs.merge_v0"
    assert set(hmi_marl.__all__) <= set(dir(hmi_marl))


IDS = ("hmi_marl/MergeDriver-v0", "hmi_marl/MergeHMI-v0")


@pytest.mark.usefixtures("unmeasured")
def test_an_id_that_names_the_module_resolves_in_a_fresh_process():
    for name in IDS:
        printed = python(
            f"import gymnasium\nenv = gymnasium.make('hmi_marl:{name}', duration=0.4)\n"
            "env.reset(seed=0)\nprint(env.spec.id)"
        )
        assert printed.splitlines()[-1] == name


@pytest.mark.usefixtures("unmeasured")
@pytest.mark.slow
def test_ids_resolve_in_spawned_workers(tmp_path):
    script = tmp_path / "workers.py"
    script.write_text(
        "import gymnasium\n"
        "if __name__ == '__main__':\n"
        "    import hmi_marl  # here alone, not in the workers\n"
        "    for module, count in (('', 2), ('hmi_marl:', 1)):\n"
        f"        envs = gymnasium.make_vec(module + '{IDS[1]}', num_envs=count, duration=0.4,\n"
        "            vectorization_mode='async', vector_kwargs={'context': 'spawn'})\n"
        "        print(envs.reset(seed=0)[0].shape[0])\n"
        "        envs.close()\n"
    )
    run = subprocess.run([sys.executable, script], capture_output=True, text=True, check=False)
    assert run.returncode == 0, run.stderr
    assert run.stdout.splitlines()[-2:] == ["2", "1"]


@pytest.mark.usefixtures("unmeasured")
def test_the_entry_point_registers_and_registering_again_does_not_warn():
    groups = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["entry-points"]
    assert groups == {"gymnasium.envs": {"__root__": "hmi_marl:register_envs"}}
    printed = python(
        "import sys, warnings\nwarnings.simplefilter('error')\n"
        "from importlib.metadata import EntryPoint\n"
        "plugin = EntryPoint('__root__', 'hmi_marl:register_envs', 'gymnasium.envs')\n"
        "plugin.load()()\nplugin.load()()\n"
        "import gymnasium, pettingzoo\n"
        "print([name for name in gymnasium.registry if name.startswith('hmi_marl/')])\n"
        "print('hmi_marl/merge-v0' in pettingzoo.aec_registry)\n"
        "print('hmi_marl/merge-v0' in pettingzoo.parallel_registry)"
    )
    assert printed.splitlines() == [str(list(IDS)), "True", "True"]


@pytest.mark.usefixtures("unmeasured")
def test_a_plugin_loader_may_call_it_while_gymnasium_is_being_imported():
    printed = python(  # as Gymnasium did up to 0.29, at the end of gymnasium.envs
        "import importlib.abc, importlib.machinery, sys\n"
        "class Loads(importlib.abc.MetaPathFinder):\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name != 'gymnasium.envs':\n"
        "            return None\n"
        "        spec = importlib.machinery.PathFinder.find_spec(name, path)\n"
        "        execute = spec.loader.exec_module\n"
        "        def then(module):\n"
        "            execute(module)\n"
        "            import hmi_marl\n"
        "            hmi_marl.register_envs()\n"
        "        spec.loader.exec_module = then\n"
        "        return spec\n"
        "sys.meta_path.insert(0, Loads())\n"
        "import gymnasium\n"
        f"print(gymnasium.make('{IDS[1]}').spec.id)"
    )
    assert printed.splitlines()[-1] == IDS[1]


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
        own = ("alerts", "driver_files", "drivers", "elementwise", "streams")
        allowed = ("numpy", "hmi_marl.checks", *(f"hmi_marl.envs.{name}" for name in own))
        ours = {name for name in imported if name.split(".")[0] not in sys.stdlib_module_names}
        assert all(name.startswith(allowed) for name in ours), (module, ours)


def test_imports_point_downwards_in_the_order_of_the_contract():
    layers = [re.findall(r"\w+", layer) for layer in _contract("layers")["layers"]]
    place = {name: number for number, layer in enumerate(layers) for name in layer}
    for module, imported in _imports().items():
        for name in imported:
            above, below = place[_children(module)[0]], place[_children(name)[0]]
            assert above <= below, f"{module} imports {name}, which is above it"


def test_no_package_and_no_module_imports_itself_by_way_of_others():
    for package in ["", *(f"{name}." for name in _packages())]:
        siblings = {}
        for module, imported in _imports().items():
            for name in imported:
                if module.startswith(package) and name.startswith(package):
                    one, other = (_children(each, package)[0] for each in (module, name))
                    siblings.setdefault(one, set()).update({other} - {one})
        graphlib.TopologicalSorter(siblings).prepare()  # a CycleError names the circle


def test_torch_is_imported_only_where_the_contract_says():
    contract = _contract("torch")
    forbidden = set(contract["forbidden_modules"])
    allowed = [line.split(" -> ")[0] for line in contract["ignore_imports"]]
    for path in (ROOT / "hmi_marl").rglob("*.py"):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts)
        found = {name.split(".")[0] for name in _imported(path)} & forbidden
        assert not found or any(fnmatch.fnmatch(module, each) for each in allowed), module


def _contract(name):
    contracts = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    (found,) = (each for each in contracts["contracts"] if each["id"] == name)
    return found


def _packages():
    inits = (ROOT / "hmi_marl").glob("*/**/__init__.py")
    return [".".join(path.parent.relative_to(ROOT / "hmi_marl").parts) for path in inits]


def _children(name, package=""):
    return name.removeprefix(package).split(".")


@functools.cache
def _imports():
    """The modules that each module imports, by their names below hmi_marl; itself as a package."""
    files = {
        ".".join(path.relative_to(ROOT / "hmi_marl").with_suffix("").parts): path
        for path in (ROOT / "hmi_marl").rglob("*.py")
    }
    packages = {name.removesuffix(".__init__") for name in files if name.endswith(".__init__")}
    known = {*files, *packages} - {"__init__"}
    found = {}
    for module, path in files.items():
        if module == "__init__":  # the root imports its names when they are first used
            continue
        own = {name.removeprefix("hmi_marl.") for name in _imported(path)}
        whole = {name if name in known else name.rpartition(".")[0] for name in own}
        found[module] = (whole & known) - {module.removesuffix(".__init__")}
    return found


def _imported(path):
    """Everything that a file imports, also in functions, but for type checkers alone."""

    def walk(node):
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING":
            return
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        if isinstance(node, ast.ImportFrom):
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
        for child in ast.iter_child_nodes(node):
            yield from walk(child)

    return set(walk(ast.parse(path.read_text())))


def test_the_version_is_written_once_and_the_citation_agrees():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert project["dynamic"] == ["readme", "version"]
    assert project["license"] == "MIT"
    assert f"version: {hmi_marl.__version__}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {hmi_marl.__version__} " in (ROOT / "CHANGELOG.md").read_text()


def pins():
    """Version of each pinned package, by its name in lower case."""
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pinned = [line.split("==") for line in lines if "==" in line and not line.startswith("#")]
    return {name.lower(): version for name, version in pinned}


def test_the_build_backend_is_pinned_to_the_same_versions():
    built_by = tomllib.loads((ROOT / "pyproject.toml").read_text())["build-system"]["requires"]
    assert len(built_by) == 2
    for requirement in built_by:
        name, version = requirement.split("==")
        assert pins()[name] == version
    for needed in ("editables", "packaging", "pathspec", "pluggy", "tomlkit", "trove-classifiers"):
        assert needed in pins()
    assert (
        "PIP_CONSTRAINT=constraints.txt PIP_BUILD_CONSTRAINT=constraints.txt"
        in (ROOT / "Makefile").read_text()
    )


def test_every_dependency_is_pinned():
    pyproject = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = list(pyproject["dependencies"])
    for extra in pyproject["optional-dependencies"].values():
        wanted += extra
    pinned = set(pins())
    for requirement in wanted:
        name = re.match(r"[\w-]+", requirement).group().lower()
        assert name in pinned or name.replace("-", "_") in pinned, name


def test_files_keep_their_size():
    for path in (ROOT / "hmi_marl").rglob("*.py"):
        assert len(path.read_text().splitlines()) <= 400, path
