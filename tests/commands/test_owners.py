"""A folder in which one command works is refused to every other command that writes folders."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

from hmi_marl.cli import main
from hmi_marl.ownership import OWNER

HOLD = """
import sys
from pathlib import Path
from hmi_marl.ownership import owned
with owned(Path(sys.argv[1])):
    print("owned", flush=True)
    sys.stdin.read()
"""


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """A folder that another process owns."""
    folder = tmp_path_factory.mktemp("taken")
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    with subprocess.Popen([sys.executable, "-c", HOLD, str(folder)], **pipes) as process:
        assert process.stdout.readline()
        yield folder, process.pid
        process.kill()


@pytest.mark.parametrize(
    "command",
    [
        "train two-stage",
        "train joint --processes 1 --device cpu",
        "train simultaneous --processes 2 --device cpu",
        "collect --driver-policy rule",
        "compare --quick",
        "table --hmis NoHMI --drivers bart",
        "adapt --quick",
        "bench",
        "reproduce --quick",
        "reproduce graded --quick",
        "reproduce hidden --driver-run trained:driver",
    ],
)
def test_the_second_command_is_refused_in_one_line(command, taken, capsys):
    pytest.importorskip("torch")
    folder, owner = taken
    assert main([*command.split(), "--out", str(folder)]) == 2
    printed = capsys.readouterr()
    assert re.fullmatch(rf"hmi-marl: \S+ is in use by process {owner} .*--out\n", printed.err)
    assert printed.out == ""
    assert [path.name for path in Path(folder).iterdir()] == [OWNER]
