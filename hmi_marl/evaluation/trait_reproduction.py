"""The paper's experiments on latent traits, made again: collect, learn three settings, judge."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import current_process, get_context
from pathlib import Path
from typing import Any

from tqdm import tqdm

from hmi_marl.agents.trait_files import load_traits
from hmi_marl.agents.trait_model import TraitModel
from hmi_marl.evaluation.collect import collect
from hmi_marl.evaluation.trait_assessment import PARTS, Assessment, assess, exact_evidence
from hmi_marl.evaluation.trait_report import (
    accuracy_figure,
    as_html,
    as_json,
    as_text,
    embeddings_figure,
)
from hmi_marl.evaluation.trait_settings import (
    DEMONSTRATIONS,
    SUPERVISIONS,
    AssessSettings,
    TraitReproduction,
)
from hmi_marl.evaluation.traits import Split
from hmi_marl.files import make_folder, write_bytes, write_json, write_text
from hmi_marl.training.demonstration_files import (
    OBSERVED,
    read_demonstrations,
    write_demonstrations,
)
from hmi_marl.training.traits.settings import TraitSettings
from hmi_marl.workers import pool


def collect_datasets(settings: TraitReproduction, driver_run: Path, folder: Path) -> None:
    """Record what is not recorded yet."""
    for name, dataset in settings.datasets(driver_run).items():
        if (folder / name / OBSERVED).is_file():
            continue
        make_folder(folder / name)
        with tqdm(total=dataset.total_steps, unit=" steps", unit_scale=True, desc=name) as bar:
            write_demonstrations(folder / name, collect(dataset, bar.update))


def learn_all(settings: TraitReproduction, folder: Path, workers: int, typed: str) -> None:
    """Learn every setting, ``workers`` at a time; finished ones are left alone.

    Raises:
        ValueError: what :func:`hmi_marl.training.traits.run.learn_traits` refuses.
    """
    jobs = settings.trainings(folder)
    lock = get_context("spawn").RLock()
    with pool(max(1, min(workers, len(jobs))), tqdm.set_lock, lock) as workshop:
        data = folder / DEMONSTRATIONS
        for future in [workshop.submit(_learn, job, data, out, typed) for out, job in jobs.items()]:
            future.result()


def _learn(settings: TraitSettings, demonstrations: Path, folder: Path, typed: str) -> None:
    from hmi_marl.training.traits.run import learn_traits  # torch, with the threads just set

    place = current_process()._identity
    line = place[-1] - 1 if place else 0
    learn_traits(replace(settings, threads=1), demonstrations, folder, typed=typed, line=line)


def assess_runs(
    runs: Sequence[Path],
    demonstrations: Path,
    population: Path | None,
    driver_policy: str | None,
    size: AssessSettings,
) -> tuple[dict[str, list[Assessment]], int]:
    """Judge trained runs on what they held out.

    Args:
        runs: their folders.
        demonstrations: that they learnt from.
        population: of drivers they did not; None to leave that out.
        driver_policy: whose the demonstrations are; None: as they tell it.
        size: how much.

    Returns:
        Assessments by supervision, and the size of the pools.

    Raises:
        FileNotFoundError, ValueError: no such runs or demonstrations, or runs that learnt from
            other demonstrations or that pool or hold out differently.
    """
    models = [load_traits(run) for run in runs]
    first = models[0].card
    for run, model in zip(runs, models, strict=True):
        if (model.card.pool, _held_out(model)) != (first.pool, _held_out(models[0])):
            raise ValueError(f"{run} pools or holds out other windows than {runs[0]}")
    split = Split.of(read_demonstrations(demonstrations), _held_out(models[0]), size.windows)
    strangers = None if population is None else read_demonstrations(population)
    found: dict[str, list[Assessment]] = {}
    with tqdm(total=1 + PARTS * len(models), unit=" parts", desc="judging") as bar:
        exact = exact_evidence(split.unseen, driver_policy)
        bar.update()
        for model in models:
            one = assess(model, split, exact, strangers, size, bar.update)
            found.setdefault(one.supervision, []).append(one)
    ordered: dict[str, list[Assessment]] = {
        name: found[name] for name in SUPERVISIONS if name in found
    }
    return ordered, first.pool


def _held_out(model: TraitModel) -> float:
    return float(model.card.training["settings"]["held_out"])


def write_report(
    folder: Path,
    assessments: Mapping[str, Sequence[Assessment]],
    pools: int,
    seconds: Mapping[str, float],
    typed: str,
    settings: Mapping[str, Any],
) -> str:
    """Write the page, the figures and the numbers into ``folder``; returns the text."""
    text = as_text(assessments, pools, seconds)
    write_text(folder / "traits.txt", text + "\n")
    write_json(folder / "traits-report.json", as_json(assessments, pools, seconds))
    write_bytes(folder / "embeddings.png", embeddings_figure(assessments, pools))
    write_bytes(folder / "accuracy.png", accuracy_figure(assessments))
    write_text(folder / "index.html", as_html(assessments, pools, seconds, typed, settings))
    return text


class Stopwatch:
    """How long parts took, by name."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def timing(self, part: str) -> Iterator[None]:
        """Time what is done within."""
        began = time.monotonic()
        yield
        self.seconds[part] = time.monotonic() - began
