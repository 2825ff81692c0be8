"""Count the stops on the way of a demonstrations file to its figure, for a reader of the code.

The way begins in ``EvaluateTraits.run``, the command ``hmi-marl traits evaluate``, and ends where
``embeddings.png`` is written. It is traced on tiny data: windows without seeds, as they are
recorded from people, so that nothing is simulated, and one trait model.

The walk goes along the calls and reads each function of the package once, where it is called for
the first time. Calls of a function that was read already are passed over, with all that they call;
so are imports, and the constructors ``__init__`` and ``__post_init__``, which set a value up and
check it: following the data takes no look into them (``--constructors`` counts them as well). Then

- a stop is the file in which the walk begins, and each first call of a function in another file
  than its caller's, which is where an editor's "go to definition" opens another file;
- a return is a stop in a file that was visited before, so stops = files + returns. Coming back to
  the caller where a function ends is no stop.

Run: python benchmarks/walk.py
     python benchmarks/walk.py --list     # every stop, and the function that is read there
     python benchmarks/walk.py --constructors
"""

from __future__ import annotations

import argparse
import hashlib
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]  # for what makes tiny data


@dataclass
class Walk:
    """The stops of a walk, recorded by ``sys.setprofile``."""

    package: str
    """Folder of the package; functions elsewhere are not read."""
    end: str = "embeddings.png"
    """Name of the file whose writing ends the walk."""
    stops: list[tuple[str, str]] = field(default_factory=list)
    """File, below the package, and the first function that is read there."""
    passed_over: tuple[str, ...] = ("<module>", "__init__", "__post_init__")
    """Names of functions that are passed over."""
    over: bool = False
    _read: set[Any] = field(default_factory=set)
    _open: list[FrameType] = field(default_factory=list)
    """Calls that the reader is in, the innermost last."""
    _passed_over: FrameType | None = None

    def __call__(self, frame: FrameType, event: str, _: Any) -> None:
        """Note a call or a return: the function that sys.setprofile takes."""
        if self.over:
            return
        if event == "call" and self._passed_over is None:
            code = frame.f_code
            if code.co_name in self.passed_over or (self._ours(frame) and code in self._read):
                self._passed_over = frame
            elif self._ours(frame):
                self._read.add(code)
                caller = self._file(self._open[-1]) if self._open else ""
                self._open.append(frame)
                if self._file(frame) != caller:
                    self.stops.append((self._file(frame), code.co_qualname))
        elif event == "return" and frame is self._passed_over:
            self._passed_over = None
        elif event == "return" and self._open and frame is self._open[-1]:
            self._open.pop()

    def hear(self, event: str, arguments: tuple[Any, ...]) -> None:
        """End the walk where its last file is there: a hook for sys.addaudithook."""
        if event in ("open", "os.rename") and any(str(a).endswith(self.end) for a in arguments):
            self.over = True

    def _ours(self, frame: FrameType) -> bool:
        return frame.f_code.co_filename.startswith(self.package)

    def _file(self, frame: FrameType) -> str:
        return frame.f_code.co_filename.removeprefix(self.package).lstrip("/")

    @property
    def files(self) -> int:
        """How many files it visits."""
        return len({file for file, _ in self.stops})


def walk(folder: Path, constructors: bool = False) -> Walk:
    """Evaluate a tiny trait model on tiny demonstrations and record the walk.

    Args:
        folder: for the data and what is written.
        constructors: count them too.
    """
    from demonstrations import LAYOUT, made_up
    from trait_models import untrained

    import hmi_marl
    from hmi_marl.agents.learned.trait_model import save_traits
    from hmi_marl.cli import parse
    from hmi_marl.demonstrations.parquet import write_demonstrations

    each, names = 20, ("lisa", "homer")
    drivers = [driver for driver in range(len(names)) for _ in range(each)]
    data = made_up([6] * len(drivers), driver=drivers, names=names, with_seeds=False)
    write_demonstrations(folder / "data", data)
    digest = hashlib.sha256((folder / "data" / "observed.parquet").read_bytes()).hexdigest()
    learned_from = {"settings": {"held_out": 0.5}, "demonstrations": digest}
    model = untrained(LAYOUT, pool=2, training=learned_from)
    save_traits(folder / "model", model.card, model.weights)
    arguments = [str(folder / "model"), "--demonstrations", str(folder / "data")]
    command: Any = parse(["traits", "evaluate", *arguments, "--out", str(folder / "out")])
    found = Walk(str(Path(hmi_marl.__file__).parent))
    if constructors:
        found.passed_over = ("<module>",)
    sys.addaudithook(found.hear)
    sys.setprofile(found)
    try:
        command.what.run("hmi-marl traits evaluate")
    finally:
        sys.setprofile(None)
    if not found.over:
        raise RuntimeError(f"{found.end} was not written")
    return found


def main() -> None:
    """Print the count."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--list", action="store_true", help="print every stop")
    parser.add_argument("--constructors", action="store_true", help="count constructors too")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        found = walk(Path(folder), arguments.constructors)
    if arguments.list:
        for number, (file, function) in enumerate(found.stops, 1):
            print(f"{number:3}  {file}  {function}")
    stops = len(found.stops)
    print(f"{stops} stops in {found.files} files, {stops - found.files} returns")


if __name__ == "__main__":
    main()
