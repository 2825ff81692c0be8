import importlib.metadata
import re
import sys
import tomllib
from pathlib import Path

import pytest

from hmi_marl.extras import EXTRAS, need, needing

PROJECT = tomllib.loads((Path(__file__).parents[1] / "pyproject.toml").read_text())["project"]
NOT_FOR_COMMANDS = {"dev", "docs"}


def test_the_modules_of_each_extra_are_those_that_it_installs():
    installs = importlib.metadata.packages_distributions()
    assert set(EXTRAS) == set(PROJECT["optional-dependencies"]) - NOT_FOR_COMMANDS
    for extra, modules in EXTRAS.items():
        wanted = {
            re.match(r"[\w-]+", line)[0].lower() for line in PROJECT["optional-dependencies"][extra]
        }
        if "minari[hdf5]" in " ".join(PROJECT["optional-dependencies"][extra]):
            wanted.add("h5py")
        found = {installs[module][0].lower().replace("_", "-") for module in modules}
        assert found == wanted, extra


def test_what_is_installed_is_not_missed():
    need("this test", "torch", "sklearn")


@pytest.mark.parametrize(
    ("modules", "message"),
    [
        (["torch", "rsl_rl"], "it needs torch: pip install 'hmi-marl[train]'"),
        (["pyarrow", "torch"], "it needs torch and pyarrow: pip install 'hmi-marl[train,data]'"),
        (["imageio_ffmpeg"], "it needs imageio_ffmpeg: pip install 'hmi-marl[video]'"),
    ],
)
def test_all_missing_extras_are_named_at_once(modules, message, monkeypatch):
    for module in modules:
        monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(ModuleNotFoundError) as error:
        need("it", *modules)
    assert str(error.value) == message


def test_an_import_that_fails_for_want_of_an_extra_names_it(monkeypatch):
    monkeypatch.setitem(sys.modules, "onnx", None)
    with (
        pytest.raises(ModuleNotFoundError, match=r"^exporting needs onnx: pip .*\[train\]'$"),
        needing("exporting"),
    ):
        import onnx  # noqa: F401


def test_other_missing_modules_stay_as_they_are():
    with (
        pytest.raises(ModuleNotFoundError, match="No module named 'no_such_module'"),
        needing("it"),
    ):
        import no_such_module  # noqa: F401
