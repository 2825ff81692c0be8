"""Ship a finished comparison: its report, and the trained pairs whose results it shows.

``compare.json`` has the checksums of the weights of every run, so the report and the pairs that
ship can be checked to be of one comparison.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

from hmi_marl.agents.learned.cards import FOLDER, shipped_agents
from hmi_marl.experiments.experiment import Agent, Place
from hmi_marl.experiments.protocols.experiment import ProtocolComparison
from hmi_marl.experiments.protocols.shippable import TrainedSeat, all_shippable, shippable
from hmi_marl.file_index import INDEX, check_files, put_back, replaced
from hmi_marl.files import sha256_of, write_bytes, write_json
from hmi_marl.ownership import check_free
from hmi_marl.reading import read_bytes, read_json
from hmi_marl.reporting.report import PAGE, index_report, indexed_files
from hmi_marl.reproduction.shipping import MOST_REPORT, fill, ship_more, without_places
from hmi_marl.typed_json import read_as, read_value

NAME = ProtocolComparison.files
"""Name of a comparison's report."""
NUMBERS = f"{NAME}.json"
_AGAIN = (
    "run its hmi-marl compare to the end, also if it was before: what is trained is not trained "
    "again"
)
_ANEW = "ship the comparison anew (hmi-marl reproduce ship --compare)"


@dataclass(frozen=True)
class FinishedComparison:
    """Folder of a comparison whose report and weights are all of one making."""

    folder: Path
    settings: ProtocolComparison
    files: Mapping[str, str]
    """Checksums of its report's files, by their names."""

    @property
    def agents(self) -> list[Agent]:
        """Trained pairs that ship."""
        return self.settings.agents(Place(self.folder, self.folder))


def find_comparison(folder: Path) -> FinishedComparison:
    """Check that ``folder`` has a finished comparison.

    Raises:
        FolderInUseError: one is running there.
        FileNotFoundError: its report is not finished, or a file is missing.
        ValueError: it is something else, or a file of the report or of the trained pairs that
            ship has changed since.
    """
    check_free(folder)
    files = indexed_files(folder, NAME, _AGAIN)
    check_files(folder, files, "that its report was written with", _AGAIN)
    settings, learned = _read(folder / NUMBERS, _AGAIN)
    for one in shippable(settings.plans()):
        weights = one.run.folder(folder) / f"{one.seat}.safetensors"
        if not weights.is_file():
            raise FileNotFoundError(f"{weights} is missing; {_AGAIN}")
        if sha256_of(weights) != _weights(learned, one):
            raise ValueError(f"{weights} has changed since {NUMBERS} was written; {_AGAIN}")
    return FinishedComparison(folder, settings, files)


def ship_comparison(folder: Path, out: Path, report: Path | None = None) -> list[Agent]:
    """Add the trained pairs of a finished comparison to the shipped agents, and copy its report.

    Both folders are replaced together, when all is written: the pairs take the place of agents of
    the same names, text, JSON, figures and clips that of an earlier report; what else is in the
    folders stays.

    Args:
        folder: folder of the comparison.
        out: folder of the shipped agents.
        report: folder of the shipped report: a new one, an empty one, or that of an earlier
            report; None to ship the pairs alone.

    Raises:
        FolderInUseError, FileNotFoundError, ValueError: see :func:`find_comparison`; or ``out``
            holds no shipped agents, or would then hold pairs of two comparisons; or ``report``
            holds something else. Nothing is written then.
    """
    for each in (out, *([report] if report else [])):
        put_back(each)
    found = find_comparison(folder)
    agents = found.agents
    if not agents and report is None:
        raise ValueError(f"the comparison in {folder} has no agents to ship; give --report")
    _check_pairs(found.settings, out)
    if report is None:
        ship_more(agents, out)
        return agents
    _check_report(report, folder, out)
    before = shipped_agents(out)
    with replaced(out, report) as (trained, shown):
        fill(trained, agents, before, out)
        _copy_report(found, report, shown)
    return agents


def check_shipped(report: Path, trained: Path = FOLDER) -> list[str]:
    """Check that a shipped report is whole, and that the pairs that ship are those it shows.

    Returns:
        The names of these pairs.

    Raises:
        FileNotFoundError: a file or an agent is missing.
        ValueError: a file is not the one that was shipped, or a pair is of another comparison.
    """
    check_files(report, indexed_files(report, NAME, _ANEW), "that was shipped", _ANEW)
    settings, learned = _read(report / NUMBERS, _ANEW)
    agents, wanted = shipped_agents(trained), shippable(settings.plans())
    for one in wanted:
        if one.name not in agents:
            raise FileNotFoundError(f"{trained} has no agent {one.name}; {_ANEW}")
        path = f"{one.name}/{one.seat}.safetensors"
        if agents[one.name].files.get(path) != _weights(learned, one):
            raise ValueError(
                f"{one.name} in {trained} is not of the comparison that {report} shows; {_ANEW}"
            )
    _check_pairs(settings, trained)
    return [one.name for one in wanted]


def _read(path: Path, remedy: str) -> tuple[ProtocolComparison, dict[str, dict[str, str]]]:
    """Settings of a comparison, and the checksums of its runs' weights by run and seat."""
    content = read_json(path, MOST_REPORT, MOST_REPORT)
    try:
        settings = read_as(ProtocolComparison, content["settings"])
        learned = {
            run: read_value(dict[str, str], training["weights"], "weights")
            for task in content["tasks"].values()
            for run, training in task["training"].items()
        }
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise ValueError(
            f"{path} is no comparison with the checksums of its weights ({error!r}); {remedy}"
        ) from None
    return settings, learned


def _weights(learned: Mapping[str, Mapping[str, str]], one: TrainedSeat) -> str | None:
    return learned.get(one.run.name, {}).get(one.seat)


def _check_pairs(settings: ProtocolComparison, trained: Path) -> None:
    """Check that agents of a comparison will not lie next to those of another one."""
    own = {one.name for one in shippable(settings.plans())}
    others = sorted({one.name for one in all_shippable()} & shipped_agents(trained).keys() - own)
    if own and others:
        raise ValueError(
            f"{trained} has {others[0]}, which is of another comparison; ship one of all of "
            f"{', '.join(dict.fromkeys(one.run.arm for one in all_shippable()))}"
        )


def _check_report(report: Path, folder: Path, out: Path) -> None:
    """Check that a folder is one that a report can be shipped to."""
    check_free(report)
    places = [each.resolve() for each in (report, folder, out)]
    for other in places[1:]:
        if places[0] in (other, *other.parents) or other in places[0].parents:
            raise ValueError(f"{report} overlaps with {other}; choose another --report")
    if not report.exists() or not any(report.iterdir()):
        return
    if (report / PAGE).exists() or not (report / NUMBERS).is_file():
        raise ValueError(
            f"{report} holds other things than a shipped comparison; choose another --report"
        )
    _before(report)


def _before(report: Path) -> Iterable[str]:
    """Names of the files of an earlier report; none if it has no index."""
    if not (report / INDEX).exists():
        return []
    remedy = f"remove {INDEX}, and what else is of the report before"
    return indexed_files(report, NAME, remedy)


def _copy_report(found: FinishedComparison, report: Path, made: Path) -> None:
    """Write what is shown of a report, and other files of ``report``, into an empty folder."""
    if report.exists():
        shutil.copytree(report, made, symlinks=True, dirs_exist_ok=True)
        for name in (*_before(report), INDEX):
            (made / name).unlink(missing_ok=True)
    names = [name for name in found.files if name != PAGE]  # which shows the others once more
    for name in names:
        if name == NUMBERS:
            content = read_json(found.folder / name, MOST_REPORT, MOST_REPORT)
            write_json(made / name, without_places(content))
        else:
            write_bytes(made / name, read_bytes(found.folder / name, MOST_REPORT))
    index_report(made, NAME, names)
